// What pointers and keys do to the table: choose, drag goals, push, lift, pan and zoom.

import { poseOf, within } from "./parcels.js";

/** A goal that is dragged is sent this often [ms], and again while the hand rests. */
const SEND_MS = 33, HOLD_MS = 300;
/** An arrow of so many metres pushes with 1 N s. */
const PUSH_N_S_PER_M = 5;
const NEAR_PX = 14;

export class Hands {
  constructor(picture, page) {
    this.picture = picture;
    this.view = picture.view;
    this.page = page;
    this.tool = "goal";
    this.dragged = null;
    this.pointers = new Map();
    this.sent_ms = 0;
    const canvas = picture.canvas;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.up(event, true));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.view.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
      page.redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("keydown", ({ key }) => {
      if (key !== "Escape") return;
      this.cancel();
      this.pointers.clear();
    });
    setInterval(() => this.hold(), HOLD_MS);
  }

  /** The number of the parcel under a point, and where it is; the top one of several. */
  parcelAt(point) {
    const { table, snapshot } = this.page;
    for (let p = table.parcels.length - 1; p >= 0; p--) {
      for (const poses of [snapshot.parcel_believed, snapshot.parcel_true]) {
        const pose = poseOf(poses, p);
        if (pose && within(table.parcels[p].outline_m, pose, point)) return { parcel: p, pose: [...pose] };
      }
    }
    return null;
  }

  /** What of a goal is under a point: its handle, or its cross. */
  goalAt(px, py) {
    const { table, snapshot } = this.page;
    for (let p = table.parcels.length - 1; p >= 0; p--) {
      const goal = poseOf(snapshot.parcel_goal, p, true);
      if (!goal) continue;
      const yaw = Number.isNaN(goal[2]) ? poseOf(snapshot.parcel_believed, p)?.[2] ?? 0 : goal[2];
      const pose = [goal[0], goal[1], yaw];
      const [hx, hy] = this.picture.parcels.handleOf(table.parcels[p], pose);
      if (Math.hypot(this.view.px(hx) - px, this.view.py(hy) - py) < NEAR_PX) return { parcel: p, pose, turn: true };
      if (Math.hypot(this.view.px(goal[0]) - px, this.view.py(goal[1]) - py) < NEAR_PX) return { parcel: p, pose, turn: false };
    }
    return null;
  }

  down(event) {
    if (!this.page.snapshot) return;
    this.picture.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (this.pointers.size > 1) {
      this.cancel();
      return;
    }
    this.from = [event.offsetX, event.offsetY];
    this.moved = false;
    const point = this.view.at(event.offsetX, event.offsetY);
    const goal = this.tool === "goal" ? this.goalAt(event.offsetX, event.offsetY) : null;
    const hit = goal ?? this.parcelAt(point);
    this.held = null;
    if (!hit || !this.page.mayMove) return;
    this.held = { ...hit, start: point, pose: [...hit.pose], from: [...hit.pose], turn: goal?.turn ?? false };
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.hover(event);
      return;
    }
    const now = [event.offsetX, event.offsetY];
    if (this.pointers.size === 2) this.pinch(event.pointerId, before, now);
    this.pointers.set(event.pointerId, now);
    if (this.pointers.size > 1) return;
    if (!this.moved && Math.hypot(now[0] - this.from[0], now[1] - this.from[1]) < 4) return;
    this.moved = true;
    if (this.held) this.drag(this.view.at(...now));
    else this.view.pan((before[0] - now[0]) / this.view.scale, (now[1] - before[1]) / this.view.scale);
    this.page.redraw();
  }

  hover(event) {
    if (!this.page.snapshot) return;
    const hit = this.goalAt(event.offsetX, event.offsetY) ?? this.parcelAt(this.view.at(event.offsetX, event.offsetY));
    this.picture.canvas.style.cursor = hit && this.page.mayMove ? "grab" : "default";
  }

  drag(point) {
    const held = this.held, dx = point[0] - held.start[0], dy = point[1] - held.start[1];
    if (this.tool === "push" && !this.page.table.parcels[held.parcel].unknown) {
      this.dragged = { parcel: null, arrow: [held.start[0], held.start[1], ...point] };
    } else if (this.tool === "lift" && !this.page.table.parcels[held.parcel].unknown) {
      held.pose = [held.from[0] + dx, held.from[1] + dy, held.from[2]];
      this.dragged = { parcel: held.parcel, ghost: held.pose, pose: null };
      this.lift(held);
    } else if (this.page.table.parcels[held.parcel].unknown) {
      this.dragged = null;
    } else {
      held.pose = held.turn
        ? [held.from[0], held.from[1], Math.atan2(point[1] - held.from[1], point[0] - held.from[0])]
        : [held.from[0] + dx, held.from[1] + dy, held.from[2]];
      this.dragged = { parcel: held.parcel, pose: held.pose, refused: held.refused };
      const now_ms = performance.now();
      if (now_ms - this.sent_ms >= SEND_MS) this.sendGoal(held, true);
    }
  }

  /** A goal counts for good once it is let go of; without a hand on it the parcel stays. */
  sendGoal(hand, held) {
    this.sent_ms = performance.now();
    const [x_m, y_m, yaw_rad] = hand.pose;
    const goal = { parcel: this.page.table.parcels[hand.parcel].name, x_m, y_m, yaw_rad, held };
    this.page.order("goal", goal).then(({ ok }) => { hand.refused = !ok; });
  }

  hold() {
    if (this.held && this.moved && this.tool === "goal" && !this.page.table.parcels[this.held.parcel].unknown) this.sendGoal(this.held, true);
  }

  lift(held) {
    if (held.lifting) return;
    const parcel = this.page.table.parcels[held.parcel].name;
    held.lifting = this.page.order("fault", { fault: { kind: "lift", parcel } });
  }

  up(event, cancelled = false) {
    if (!this.pointers.delete(event.pointerId) || this.pointers.size) return;
    const held = this.held;
    if (held && this.moved) this.letGo(held, cancelled);
    else if (!this.moved && !cancelled) this.choose(event);
    this.drop();
  }

  letGo(held, cancelled) {
    const thing = this.page.table.parcels[held.parcel];
    if (thing.unknown) {
      if (!cancelled) this.page.askName(held.parcel);
    } else if (this.tool === "push" && !cancelled) {
      const [x, y, to_x, to_y] = this.dragged.arrow;
      const impulse = [(to_x - x) * PUSH_N_S_PER_M, (to_y - y) * PUSH_N_S_PER_M];
      const parcel = this.page.table.parcels[held.parcel].name;
      this.page.order("fault", { fault: { kind: "push", parcel, impulse_n_s: impulse } });
    } else if (this.tool === "lift") {
      held.lifting?.then((answer) => this.setDown(held, answer, cancelled));
    } else if (!cancelled) {
      this.sendGoal(held, false);
    }
  }

  async setDown(held, answer, cancelled) {
    if (!answer.ok) return;
    const number = Number(answer.text.split(" ")[1]);
    const [x_m, y_m, yaw_rad] = held.pose;
    const where = cancelled ? {} : { x_m, y_m, yaw_rad };
    const down = await this.page.order("end_fault", { number, ...where });
    // Beside the table it would fall: it goes back to where it was.
    if (!down.ok) this.page.order("end_fault", { number });
  }

  /** Ends a drag without its deed: a parcel that was lifted goes back to where it was. */
  cancel() {
    if (this.held && this.moved) this.letGo(this.held, true);
    this.drop();
  }

  drop() {
    this.held = this.dragged = null;
    this.page.redraw();
  }

  choose(event) {
    const point = this.view.at(event.offsetX, event.offsetY), { table } = this.page;
    const hit = this.parcelAt(point);
    if (hit && !event.altKey && !(this.picture.chosen?.kind === "parcel" && this.picture.chosen.number === hit.parcel)) {
      this.page.choose({ kind: "parcel", number: hit.parcel });
      return;
    }
    const half = table.pitch_m / 2;
    const cell = table.cells_m.findIndex(([x, y]) => Math.abs(x - point[0]) < half && Math.abs(y - point[1]) < half);
    this.page.choose(cell < 0 ? null : { kind: "cell", number: cell });
  }

  pinch(id, before, now) {
    const [other] = [...this.pointers].filter(([key]) => key !== id).map(([, at]) => at);
    const was = Math.hypot(before[0] - other[0], before[1] - other[1]);
    const is = Math.hypot(now[0] - other[0], now[1] - other[1]);
    this.view.pan((before[0] - now[0]) / this.view.scale / 2, (now[1] - before[1]) / this.view.scale / 2);
    if (was > 10) this.view.zoom(is / was, (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    this.page.redraw();
  }

  key(event) {
    const step = 40 / this.view.scale;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (moves[event.key]) this.view.pan(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") this.view.zoom(1.25);
    else if (event.key === "-") this.view.zoom(0.8);
    else if (event.key === "0") this.view.fit(this.page.table);
    else return;
    event.preventDefault();
    this.page.redraw();
  }
}
