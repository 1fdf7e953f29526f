// Draws parcels: as they are believed and are, where they are to go, and what hands do to them.

export class ParcelsPicture {
  constructor(context, view, colours) {
    Object.assign(this, { context, view, colours });
  }

  draw(snapshot, dragged, { chosen, showTrue }) {
    this.named = dragged?.parcel ?? (chosen?.kind === "parcel" ? chosen.number : null);
    const { parcels } = this.table, context = this.context;
    for (let p = 0; p < parcels.length; p++) {
      const pose = poseOf(snapshot.parcel_true, p);
      if (showTrue && pose) {
        this.trace(parcels[p].outline_m, pose);
        context.strokeStyle = this.colours.true;
        context.lineWidth = 1.5;
        context.setLineDash([5, 4]);
        context.stroke();
        context.setLineDash([]);
      }
    }
    for (let p = 0; p < parcels.length; p++) {
      const pose = poseOf(snapshot.parcel_believed, p);
      if (pose) this.drawBelieved(parcels[p], pose, snapshot, p);
    }
    for (let p = 0; p < parcels.length; p++) {
      const goal = dragged?.parcel === p ? dragged.pose : poseOf(snapshot.parcel_goal, p, true);
      const colour = dragged?.parcel === p && dragged.refused ? this.colours.slip : this.colours.goal;
      if (goal) this.drawGoal(parcels[p], goal, poseOf(snapshot.parcel_believed, p), colour);
    }
    if (dragged?.arrow) this.drawPush(dragged.arrow);
    if (dragged?.ghost) {
      this.trace(parcels[dragged.parcel].outline_m, dragged.ghost);
      context.strokeStyle = this.colours.text;
      context.lineWidth = 2;
      context.stroke();
    }
    if (chosen) this.drawChosen(snapshot, chosen);
  }

  drawBelieved(parcel, pose, snapshot, p) {
    const context = this.context, doubtful = snapshot.parcel_state[p] === 2;
    this.trace(parcel.outline_m, pose);
    context.fillStyle = this.colours["parcel-fill"];
    context.fill();
    context.lineWidth = 2;
    context.strokeStyle = parcel.unknown ? this.colours.faint : this.colours.parcel;
    context.setLineDash(doubtful ? [2, 5] : parcel.unknown ? [8, 4] : []);
    context.stroke();
    context.setLineDash([]);
    if (!parcel.unknown) this.drawSpread(pose, snapshot.parcel_spread, p);
    context.fillStyle = this.colours.text;
    context.font = '600 13px system-ui, "DejaVu Sans", sans-serif';
    context.textAlign = "center";
    context.textBaseline = "bottom";
    const note = snapshot.parcel_state[p] === 3 ? " ✓" : doubtful ? " ?" : "";
    const room = p === this.named ? Infinity : 2 * this.view.scale * Math.max(...parcel.outline_m.map(([x, y]) => Math.hypot(x, y)));
    const at = [this.fitting(parcel.name, room) + note, this.view.px(pose[0]), this.view.py(pose[1]) - 8];
    // What lies under it stays beside it.
    context.strokeStyle = this.colours.back;
    context.lineWidth = 4;
    context.lineJoin = "round";
    context.strokeText(...at);
    context.fillText(...at);
  }

  /** As many of a name's last words as there is room for [pixels], or the end of a long one; the number of a parcel is the last. */
  fitting(name, room) {
    const fits = (text) => this.context.measureText(text).width <= room;
    const words = name.split(" ");
    while (words.length > 1 && !fits(words.join(" "))) words.shift();
    let text = words.join(" ");
    for (let rest = text.slice(1); !fits(text); rest = rest.slice(1)) {
      if (rest.length < 3) return "";
      text = `…${rest}`;
    }
    return text;
  }

  /** Where the centre is with 95 %: an ellipse of 2.45 standard deviations; and a nose for the yaw. */
  drawSpread(pose, spread, p) {
    const [xx, xy, yy, yaw] = spread.subarray(4 * p, 4 * p + 4);
    const context = this.context, px = this.view.px(pose[0]), py = this.view.py(pose[1]);
    context.strokeStyle = this.colours.spread;
    context.lineWidth = 1.5;
    if (xx >= 0) {
      const middle = (xx + yy) / 2, off = Math.hypot((xx - yy) / 2, xy);
      const turn = 0.5 * Math.atan2(2 * xy, xx - yy);
      const long = 2.45 * Math.sqrt(Math.max(0, middle + off)) * this.view.scale;
      const short = 2.45 * Math.sqrt(Math.max(0, middle - off)) * this.view.scale;
      context.beginPath();
      context.ellipse(px, py, Math.max(1.5, long), Math.max(1.5, short), -turn, 0, 2 * Math.PI);
      context.stroke();
    }
    const reach = 0.07 * this.view.scale;
    const open = 2.45 * Math.sqrt(Math.max(0, yaw || 0));
    context.beginPath();
    context.moveTo(px, py);
    context.lineTo(px + reach * Math.cos(pose[2]), py - reach * Math.sin(pose[2]));
    context.arc(px, py, reach, -pose[2] - open, -pose[2] + open);
    context.stroke();
  }

  drawGoal(parcel, goal, believed, colour) {
    const context = this.context, yaw = Number.isNaN(goal[2]) ? believed?.[2] ?? 0 : goal[2];
    const px = this.view.px(goal[0]), py = this.view.py(goal[1]);
    context.strokeStyle = context.fillStyle = colour;
    if (believed) {
      context.globalAlpha = 0.5;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(this.view.px(believed[0]), this.view.py(believed[1]));
      context.lineTo(px, py);
      context.stroke();
      context.globalAlpha = 1;
    }
    this.trace(parcel.outline_m, [goal[0], goal[1], yaw]);
    context.lineWidth = 1.5;
    context.setLineDash([2, 3]);
    context.stroke();
    context.setLineDash([]);
    context.beginPath();
    const size = Math.max(3, Math.min(7, 0.015 * this.view.scale));
    context.moveTo(px - size, py);
    context.lineTo(px + size, py);
    context.moveTo(px, py - size);
    context.lineTo(px, py + size);
    context.stroke();
    const [hx, hy] = this.handleOf(parcel, [goal[0], goal[1], yaw]);
    context.beginPath();
    context.arc(this.view.px(hx), this.view.py(hy), 0.75 * size, 0, 2 * Math.PI);
    context.fill();
  }

  /** Where the goal of a parcel is turned by: beyond the end of its own x axis. */
  handleOf(parcel, pose) {
    const reach = Math.max(...parcel.outline_m.map(([x]) => x)) + 14 / this.view.scale;
    return [pose[0] + reach * Math.cos(pose[2]), pose[1] + reach * Math.sin(pose[2])];
  }

  drawPush([x, y, to_x, to_y]) {
    const path = new Path2D();
    const px = this.view.px(x), py = this.view.py(y);
    addArrow(path, px, py, this.view.px(to_x) - px, this.view.py(to_y) - py);
    this.context.strokeStyle = this.colours.slip;
    this.context.lineWidth = 3;
    this.context.stroke(path);
  }

  drawChosen(snapshot, { kind, number }) {
    const context = this.context;
    context.strokeStyle = this.colours.text;
    context.lineWidth = 2.5;
    context.globalAlpha = kind === "cell" ? 1 : 0.4;
    if (kind === "cell") {
      const [x, y] = this.table.cells_m[number], half = 0.49 * this.table.pitch_m * this.view.scale;
      context.strokeRect(this.view.px(x) - half, this.view.py(y) - half, 2 * half, 2 * half);
    } else if (this.table.parcels[number]) {
      const pose = poseOf(snapshot.parcel_believed, number) ?? poseOf(snapshot.parcel_true, number);
      if (pose) {
        this.trace(this.table.parcels[number].outline_m, pose);
        context.lineWidth = 7;
        context.stroke();
      }
    }
    context.globalAlpha = 1;
  }

  trace(outline, [x, y, yaw]) {
    const cosine = Math.cos(yaw), sine = Math.sin(yaw), context = this.context;
    context.beginPath();
    for (const [along, across] of outline) {
      context.lineTo(this.view.px(x + cosine * along - sine * across), this.view.py(y + sine * along + cosine * across));
    }
    context.closePath();
  }
}

/** Adds an arrow to a path; one that is short has no head. */
export function addArrow(path, px, py, dx, dy) {
  const length = Math.hypot(dx, dy);
  path.moveTo(px, py);
  path.lineTo(px + dx, py + dy);
  if (length < 7) return;
  const bx = dx / length * 5, by = dy / length * 5;
  path.moveTo(px + dx - bx - by * 0.6, py + dy - by + bx * 0.6);
  path.lineTo(px + dx, py + dy);
  path.lineTo(px + dx - bx + by * 0.6, py + dy - by - bx * 0.6);
}

/** The pose of a parcel in an array of poses, null where it is not known. */
export function poseOf(poses, parcel, yawMayLack = false) {
  const pose = poses.subarray(3 * parcel, 3 * parcel + 3);
  if (!Number.isFinite(pose[0]) || (Number.isNaN(pose[2]) && !yawMayLack)) return null;
  return pose;
}

/** Whether a point lies within an outline at a pose. */
export function within(outline, [x, y, yaw], [at_x, at_y]) {
  const cosine = Math.cos(yaw), sine = Math.sin(yaw);
  const along = cosine * (at_x - x) + sine * (at_y - y), across = cosine * (at_y - y) - sine * (at_x - x);
  let inside = false;
  for (let i = 0, j = outline.length - 1; i < outline.length; j = i++) {
    const [xi, yi] = outline[i], [xj, yj] = outline[j];
    if (yi > across !== yj > across && along < (xj - xi) * (across - yi) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}
