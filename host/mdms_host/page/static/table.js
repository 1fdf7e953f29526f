// Draws the table: what seldom changes (cells, sensors) is kept as an image, the rest every time.

import { ParcelsPicture, addArrow } from "./parcels.js";

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
    this.parcels = new ParcelsPicture(this.context, view, this.colours);
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
    this.table = this.parcels.table = table;
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
    this.parcels.draw(snapshot, dragged, this);
  }

  // Cells

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
    for (const infeed of this.table.infeeds) this.drawInfeed(context, infeed);
    for (const exit of this.table.exits) this.drawExit(context, exit);
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

  /** The outline of a parcel where parcels are set down. */
  drawInfeed(context, { x_m, y_m, yaw_rad, outline_m }) {
    const cosine = Math.cos(yaw_rad), sine = Math.sin(yaw_rad), { view } = this;
    context.strokeStyle = context.fillStyle = this.colours.label;
    context.lineWidth = 1.5;
    context.setLineDash([1, 3]);
    context.beginPath();
    for (const [along, across] of outline_m) {
      context.lineTo(view.px(x_m + cosine * along - sine * across), view.py(y_m + sine * along + cosine * across));
    }
    context.closePath();
    context.stroke();
    context.setLineDash([]);
    const low = Math.max(...outline_m.map(([along, across]) => -sine * along - cosine * across));
    this.drawName(context, "infeed", view.px(x_m), view.py(y_m - low) + 3, "top");
  }

  /** A bar along a stretch of the edge, an arrow out of it, and the name. */
  drawExit(context, { name, ends_m, out }) {
    const { view } = this, [[x0, y0], [x1, y1]] = ends_m;
    const dx = 5 * out[0], dy = -5 * out[1];
    context.strokeStyle = this.colours.accent;
    context.lineWidth = 4;
    context.beginPath();
    context.moveTo(view.px(x0) + dx, view.py(y0) + dy);
    context.lineTo(view.px(x1) + dx, view.py(y1) + dy);
    context.stroke();
    const px = view.px((x0 + x1) / 2), py = view.py((y0 + y1) / 2), arrow = new Path2D();
    addArrow(arrow, px + 1.6 * dx, py + 1.6 * dy, 2.4 * dx, 2.4 * dy);
    context.lineWidth = 2;
    context.stroke(arrow);
    context.fillStyle = this.colours.accent;
    context.save();
    context.translate(px + 5.5 * dx, py + 5.5 * dy);
    if (out[0]) context.rotate(-Math.PI / 2);
    this.drawName(context, name, 0, 0, "middle");
    context.restore();
  }

  drawName(context, name, px, py, baseline) {
    context.font = '12px system-ui, "DejaVu Sans", sans-serif';
    context.textAlign = "center";
    context.textBaseline = baseline;
    context.fillText(name, px, py);
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
    const several = this.table.bus_count > 1;
    context.font = `${roomy ? Math.min(13, 0.11 * size) : several ? 8 : 9}px system-ui, "DejaVu Sans", sans-serif`;
    // Without room a name of two numbers stands on the edge, where no sensor is above it.
    context.textBaseline = roomy ? "top" : several ? "alphabetic" : "bottom";
    context.textAlign = between ? "center" : "left";
    context.fillStyle = this.colours[this.heat === "state" ? "label" : "text"];
    context.fillText(this.nameOf(cell), between ? px : px - half + (roomy ? 7 : several ? 1 : 3), roomy ? py - half + 5 : py + half + (several ? 0.5 : 0));
    if (state !== 3 && state !== 2 && roomy) {
      context.textAlign = "right";
      context.fillStyle = this.colours[{ 4: "fault-text", 5: "suspected-text" }[state] ?? "label"];
      context.fillText(STATES[state], px + half - 7, py - half + 5);
    }
  }

  /** The node id; with several buses the bus before it. */
  nameOf(cell) {
    const node = this.table.node_ids[cell];
    return this.table.bus_count > 1 ? `${this.table.buses[cell]}·${node}` : `${node}`;
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

  // Wheels

  drawWheels(snapshot) {
    const { wheels_m, wheel_directions, pitch_m } = this.table, { scale } = this.view;
    const long = 0.13 * pitch_m * scale, context = this.context;
    const rolling = new Path2D(), slipping = new Path2D(), wanted = new Path2D(), wheels = new Path2D();
    const arrow = 0.5 * pitch_m * scale / this.arrow_m_s;
    let fastest = 0;
    for (let w = 0; w < wheels_m.length; w++) {
      if (!wheels_m[w]) continue;
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
        addArrow(path, px, py, dx * speed * arrow, dy * speed * arrow);
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

  // Plans

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
}
