// Draws the table: what seldom changes (cells, sensors) is kept as an image, the rest every time.

const STATES = ["off", "silent", "ready", "running", "fault", "suspected"];
const BACKS = ["back", "silent", "cell", "running", "fault", "suspected"];
const LINES = ["cell-line", "cell-line", "cell-line", "running-line", "fault-line", "suspected-line"];
/** An arrow as long as half a pitch stands for one of these speeds [m/s], as the wheels need it. */
const ARROWS_M_S = [0.1, 0.2, 0.5, 1, 2, 5, 10];
/** Wheels that slip faster are drawn as slipping [m/s]. */
const SLIPS_M_S = 0.005;
/** Cells that are larger have their sensors drawn, their numbers, and these in their corners [pixels]. */
const SENSORS_PX = 34, NUMBERS_PX = 24, CORNERS_PX = 80;
/** Where the colours of the heatmaps end. */
const MOST = { slip: 0.05, normal: 1 };
const IDENTITIES = ["#c95c93", "#4c8f3c", "#5580d6", "#b8731d", "#9170d1", "#1f8f8f", "#cb6161", "#7a8922"];

export const colourOf = (identity) => IDENTITIES[(identity - 1) % IDENTITIES.length];

/** A number from 0 to 1 as a colour from faint yellow to dark red, readable on light and dark. */
export function heat(share) {
  const s = Math.max(0, Math.min(1, share));
  return `hsl(${50 - 50 * s} ${75 + 10 * s}% ${72 - 32 * s}% / ${0.25 + 0.65 * s})`;
}

export class TablePicture {
  constructor(canvas, view) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.view = view;
    this.base = document.createElement("canvas");
    this.kept = "";
    this.colours = {};
    this.heat = "state";
    this.showTrue = this.showPlan = true;
    this.chosen = null;
    this.most = { ...MOST };
    this.arrow_m_s = ARROWS_M_S[0];
  }

  /** Colours from the style sheet, after a change of theme. */
  readTheme() {
    const style = getComputedStyle(document.documentElement);
    const names = ["back", "panel", "text", "faint", "cell", "cell-line", "running", "running-line", "fault",
      "fault-line", "fault-text", "suspected", "suspected-line", "suspected-text", "silent", "sensor", "covered", "label", "parcel", "parcel-fill",
      "true", "goal", "wheel", "slip", "spread", "accent"];
    for (const name of names) this.colours[name] = style.getPropertyValue(`--${name}`).trim();
    this.kept = "";
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.ratio = ratio;
    for (const canvas of [this.canvas, this.base]) {
      canvas.width = Math.max(1, Math.round(clientWidth * ratio));
      canvas.height = Math.max(1, Math.round(clientHeight * ratio));
    }
    this.view.resize(clientWidth, clientHeight);
    this.kept = "";
  }

  setTable(table, anew) {
    this.table = table;
    if (anew) this.view.fit(table);
    this.kept = "";
  }

  draw(snapshot, plan, dragged) {
    if (!this.table) return;
    this.drawBase(snapshot);
    const context = this.context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.base, 0, 0);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (!snapshot) return;
    if (this.heat !== "state") this.drawHeat(snapshot);
    if (this.showPlan) this.drawPlan(plan);
    this.drawCovered(snapshot);
    this.drawWheels(snapshot);
    this.drawParcels(snapshot, dragged);
    this.drawChosen(snapshot);
  }

  // Cells ------------------------------------------------------------------------------------------

  drawBase(snapshot) {
    const s = snapshot;
    const state = s ? `${s.cell_state} ${s.cell_promise} ${s.cell_promise_state}` : "";
    const kept = `${this.view.signature} ${this.heat === "state"} ${state}`;
    if (kept === this.kept) return;
    this.kept = kept;
    const context = this.base.getContext("2d");
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.fillStyle = this.colours.back;
    context.fillRect(0, 0, this.view.width, this.view.height);
    const size = this.table.pitch_m * this.view.scale;
    this.table.cells_m.forEach(([x, y], cell) => {
      const px = this.view.px(x), py = this.view.py(y);
      if (px < -size || py < -size || px > this.view.width + size || py > this.view.height + size) return;
      this.drawCell(context, cell, px, py, size, s);
    });
  }

  drawCell(context, cell, px, py, size, snapshot) {
    const state = snapshot ? snapshot.cell_state[cell] : 0;
    const half = 0.47 * size;
    context.beginPath();
    context.roundRect(px - half, py - half, 2 * half, 2 * half, 0.07 * size);
    const plain = this.heat !== "state" && state === 3;
    context.fillStyle = this.colours[plain ? "cell" : BACKS[state]];
    context.fill();
    context.lineWidth = state >= 3 && !plain ? 1.5 : 1;
    context.strokeStyle = this.colours[plain ? "cell-line" : LINES[state]];
    context.setLineDash(state < 2 ? [4, 4] : []);
    context.stroke();
    context.setLineDash([]);
    if (state === 1) this.drawCross(context, px, py, half);
    if (snapshot) this.drawPromise(context, cell, px, py, half, snapshot);
    if (size > SENSORS_PX) this.drawSensors(context, px, py);
    if (size > NUMBERS_PX && this.heat === "state") this.drawNumber(context, cell, px, py, half, size, state);
  }

  drawCross(context, px, py, half) {
    context.strokeStyle = this.colours["cell-line"];
    context.beginPath();
    context.moveTo(px - half, py - half);
    context.lineTo(px + half, py + half);
    context.moveTo(px - half, py + half);
    context.lineTo(px + half, py - half);
    context.stroke();
  }

  /** A frame in the parcel's colour: thin where promised, thick under it, dashed near it. */
  drawPromise(context, cell, px, py, half, snapshot) {
    const identity = snapshot.cell_promise[cell], state = snapshot.cell_promise_state[cell];
    if (!identity || !state) return;
    this.promised = true;
    context.strokeStyle = colourOf(identity);
    context.lineWidth = state === 3 ? 3 : 1.5;
    context.setLineDash(state === 1 ? [2, 4] : []);
    const inner = half - 2.5;
    context.strokeRect(px - inner, py - inner, 2 * inner, 2 * inner);
    context.setLineDash([]);
  }

  /** Where sensors are; those that are covered are drawn over it every time. */
  drawSensors(context, px, py) {
    const { scale } = this.view, radius = this.sensorRadius;
    context.beginPath();
    for (const [x, y] of this.table.sensors_m) {
      context.moveTo(px + x * scale + radius, py - y * scale);
      context.arc(px + x * scale, py - y * scale, radius, 0, 2 * Math.PI);
    }
    context.lineWidth = 1;
    context.strokeStyle = this.colours.sensor;
    context.stroke();
  }

  get sensorRadius() { return Math.max(1.5, 0.0035 * this.view.scale); }

  drawCovered({ cell_presence }) {
    const { cells_m, sensors_m, pitch_m } = this.table, { view, context } = this;
    if (pitch_m * view.scale <= SENSORS_PX) return;
    const radius = this.sensorRadius, covered = new Path2D();
    cells_m.forEach(([x, y], cell) => {
      const bits = cell_presence[cell];
      for (let sensor = 0; bits >> sensor; sensor++) {
        if (!(bits >> sensor & 1)) continue;
        const px = view.px(x + sensors_m[sensor][0]), py = view.py(y + sensors_m[sensor][1]);
        covered.moveTo(px + radius, py);
        covered.arc(px, py, radius, 0, 2 * Math.PI);
      }
    });
    context.fillStyle = this.colours.covered;
    context.fill(covered);
  }

  /** Where no sensor and no wheel is: in the upper corner, between sensors, or, without these, in the lower one. */
  drawNumber(context, cell, px, py, half, size, state) {
    const roomy = size > CORNERS_PX, between = !roomy && size > SENSORS_PX;
    context.font = `${roomy ? Math.min(13, 0.11 * size) : 9}px system-ui, "DejaVu Sans", sans-serif`;
    context.textBaseline = roomy ? "top" : "bottom";
    context.textAlign = between ? "center" : "left";
    context.fillStyle = this.colours[this.heat === "state" ? "label" : "text"];
    context.fillText(this.nameOf(cell, roomy), between ? px : px - half + (roomy ? 7 : 3), roomy ? py - half + 5 : py + half);
    if (state !== 3 && state !== 2 && roomy) {
      context.textAlign = "right";
      context.fillStyle = this.colours[{ 4: "fault-text", 5: "suspected-text" }[state] ?? "label"];
      context.fillText(STATES[state], px + half - 7, py - half + 5);
    }
  }

  /** The node id; with several buses the bus before it, where there is room. */
  nameOf(cell, roomy) {
    const node = this.table.node_ids[cell];
    return this.table.bus_count > 1 && roomy ? `${this.table.buses[cell]}·${node}` : `${node}`;
  }

  drawHeat(snapshot) {
    const values = this.heat === "slip" ? snapshot.wheel_slip : snapshot.wheel_normal;
    const { axes, cells_m, pitch_m } = this.table, size = pitch_m * this.view.scale;
    const most = this.most[this.heat], half = 0.47 * size;
    for (let cell = 0; cell < cells_m.length; cell++) {
      for (let axis = 0; axis < axes; axis++) {
        const value = Math.abs(values[cell * axes + axis]);
        if (!(value > 0.01 * most)) continue;
        if (this.heat === "normal" && value > most) this.most.normal = Math.ceil(value);
        this.context.fillStyle = heat(value / most);
        const px = this.view.px(cells_m[cell][0]) - half, py = this.view.py(cells_m[cell][1]) - half;
        this.context.fillRect(px + axis * 2 * half / axes, py, 2 * half / axes - 1, 2 * half);
      }
      if (size > NUMBERS_PX) {
        this.drawNumber(this.context, cell, this.view.px(cells_m[cell][0]), this.view.py(cells_m[cell][1]), half, size, snapshot.cell_state[cell]);
      }
    }
  }

  // Wheels -----------------------------------------------------------------------------------------

  drawWheels(snapshot) {
    const { wheels_m, wheel_directions, pitch_m } = this.table, { scale } = this.view;
    const long = 0.13 * pitch_m * scale, context = this.context;
    const rolling = new Path2D(), slipping = new Path2D(), wanted = new Path2D(), wheels = new Path2D();
    const arrow = 0.5 * pitch_m * scale / this.arrow_m_s;
    let fastest = 0;
    for (let w = 0; w < wheels_m.length; w++) {
      const px = this.view.px(wheels_m[w][0]), py = this.view.py(wheels_m[w][1]);
      const dx = wheel_directions[w][0], dy = -wheel_directions[w][1];
      wheels.moveTo(px - dx * long, py - dy * long);
      wheels.lineTo(px + dx * long, py + dy * long);
      const speed = snapshot.wheel_speed[w], reference = snapshot.wheel_reference[w];
      if (Math.abs(reference) > 0.001) {
        wanted.moveTo(px, py);
        wanted.lineTo(px + dx * reference * arrow, py + dy * reference * arrow);
      }
      if (Math.abs(speed) > 0.002) {
        fastest = Math.max(fastest, Math.abs(speed));
        const path = Math.abs(snapshot.wheel_slip[w]) > SLIPS_M_S ? slipping : rolling;
        this.addArrow(path, px, py, dx * speed * arrow, dy * speed * arrow);
      }
    }
    if (fastest > 1.2 * this.arrow_m_s) this.arrow_m_s = ARROWS_M_S.find((step) => step >= fastest / 1.2) ?? 10;
    context.lineCap = "butt";
    context.lineWidth = Math.max(2, 0.055 * pitch_m * scale);
    context.globalAlpha = 0.35;
    context.strokeStyle = this.colours.wheel;
    context.stroke(wheels);
    context.globalAlpha = 0.5;
    context.lineWidth = 1;
    context.strokeStyle = this.colours.accent;
    context.stroke(wanted);
    context.globalAlpha = 1;
    context.lineWidth = Math.max(1.5, 0.016 * pitch_m * scale);
    context.strokeStyle = this.colours.wheel;
    context.stroke(rolling);
    context.strokeStyle = this.colours.slip;
    context.stroke(slipping);
  }

  addArrow(path, px, py, dx, dy) {
    const length = Math.hypot(dx, dy);
    path.moveTo(px, py);
    path.lineTo(px + dx, py + dy);
    if (length < 7) return;
    const bx = dx / length * 5, by = dy / length * 5;
    path.moveTo(px + dx - bx - by * 0.6, py + dy - by + bx * 0.6);
    path.lineTo(px + dx, py + dy);
    path.lineTo(px + dx - bx + by * 0.6, py + dy - by - bx * 0.6);
  }

  // Plans ------------------------------------------------------------------------------------------

  drawPlan(plan) {
    if (!plan) return;
    this.planned = Boolean(plan.tiles.length || Object.keys(plan.paths).length);
    const context = this.context;
    for (const { x_m, y_m, size_m, parcels } of plan.tiles ?? []) {
      const size = size_m * this.view.scale;
      context.fillStyle = colourOf(1 + Math.max(0, this.numberOf(parcels[0])));
      context.globalAlpha = 0.16;
      context.fillRect(this.view.px(x_m) - size / 2, this.view.py(y_m) - size / 2, size, size);
    }
    context.globalAlpha = 0.8;
    context.lineWidth = 2;
    context.setLineDash([7, 4]);
    for (const [name, poses] of Object.entries(plan.paths ?? {})) {
      context.strokeStyle = colourOf(1 + Math.max(0, this.numberOf(name)));
      context.beginPath();
      poses.forEach(([x, y], k) => k ? context.lineTo(this.view.px(x), this.view.py(y))
        : context.moveTo(this.view.px(x), this.view.py(y)));
      context.stroke();
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  numberOf(name) { return this.table.parcels.findIndex((parcel) => parcel.name === name); }

  // Parcels ----------------------------------------------------------------------------------------

  drawParcels(snapshot, dragged) {
    this.named = dragged?.parcel ?? (this.chosen?.kind === "parcel" ? this.chosen.number : null);
    const { parcels } = this.table, context = this.context;
    for (let p = 0; p < parcels.length; p++) {
      const pose = poseOf(snapshot.parcel_true, p);
      if (this.showTrue && pose) {
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

  /** As many of a name's last words as there is room for [pixels]; the number of a parcel is the last. */
  fitting(name, room) {
    const words = name.split(" ");
    while (words.length && this.context.measureText(words.join(" ")).width > room) words.shift();
    return words.join(" ");
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
    this.addArrow(path, px, py, this.view.px(to_x) - px, this.view.py(to_y) - py);
    this.context.strokeStyle = this.colours.slip;
    this.context.lineWidth = 3;
    this.context.stroke(path);
  }

  drawChosen(snapshot) {
    if (!this.chosen) return;
    const { kind, number } = this.chosen, context = this.context;
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
