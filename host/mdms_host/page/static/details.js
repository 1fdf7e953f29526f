// Everything about the cell or parcel that is chosen, and what can be done to it.

import { poseOf } from "./parcels.js";

const NEAR = ["", "near", "promised", "under it"];
/** A number with so many digits behind the point and its unit; none is a dash, and -0.0 is 0.0. */
const shown = (value, digits, unit) => {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace("-", "") : text) + unit;
};
const mm = (value) => shown(1e3 * value, 1, " mm");
const deg = (value) => shown(value * 180 / Math.PI, 2, "°");
const mm_s = (value) => shown(1e3 * value, 1, " mm/s");
const newtons = (value) => shown(value, 2, " N");

/** An element with attributes and children. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

export class Details {
  constructor(page) {
    this.page = page;
    this.facts = document.getElementById("facts");
    this.deeds = document.getElementById("deeds");
    this.objects = document.getElementById("objects");
    this.select = document.getElementById("chosen");
    this.select.addEventListener("change", () => {
      const [kind, number] = this.select.value.split(" ");
      page.choose(kind ? { kind, number: Number(number) } : null);
    });
    this.rows = [];
  }

  setTable(table) {
    this.table = table;
    const option = (value, text) => make("option", { value }, text);
    this.select.replaceChildren(
      option("", "the table"),
      ...table.parcels.map(({ name }, p) => option(`parcel ${p}`, `parcel ${name}`)),
      ...table.node_ids.map((node, cell) => option(`cell ${cell}`, this.cellName(cell))),
    );
  }

  cellName(cell) {
    const bus = this.table.bus_count > 1 ? `, bus ${this.table.buses[cell]}` : "";
    return `cell ${cell + 1} (node ${this.table.node_ids[cell]}${bus})`;
  }

  choose(chosen) {
    this.chosen = chosen;
    this.rows = [];
    this.objects.replaceChildren();
    this.select.value = chosen ? `${chosen.kind} ${chosen.number}` : "";
    this.showDeeds();
  }

  /** Facts of what is chosen, as [name, value]. */
  factsOf(snapshot) {
    if (!this.chosen) return this.factsOfTable(snapshot);
    const { kind, number } = this.chosen;
    return kind === "cell" ? this.factsOfCell(snapshot, number) : this.factsOfParcel(snapshot, number);
  }

  /** How many cells are in which state. */
  cellsOf(s) {
    const states = this.table.cell_states.map((name, k) => [name, s.cell_state.filter((state) => state === k).length]);
    return states.filter(([, count]) => count).map(([name, count]) => `${count} ${name}`).join(", ");
  }

  factsOfTable(s) {
    return [
      ["program", this.table.phases[s.phase[0]]],
      ["cells", this.cellsOf(s)],
      ["grid", `${this.table.columns} × ${this.table.rows}, pitch ${mm(this.table.pitch_m)}`],
      ...[...s.bus_load].map((load, b) => [this.table.bus_count > 1 ? `load of bus ${b}` : "load of the bus", `${this.table.simulated ? "" : "at most "}${(100 * load).toFixed(0)} %`]),
      ...this.flowOf(s),
      ...this.parcelsOf(s),
      ["fastest wheel", mm_s(s.wheel_speed.reduce((a, b) => Math.max(a, Math.abs(b) || 0), 0))],
    ];
  }

  /** Parcels that have come and left, where any do. */
  flowOf(s) {
    if (!Number.isFinite(s.parcels_came[0])) return [];
    return [
      ["parcels that came", `${s.parcels_came[0]}`],
      ...this.table.exits.map(({ name, kinds }, k) => [`left by ${name}${kinds.length ? ` (${kinds.join(", ")})` : ""}`, `${s.parcels_left[k]}`]),
    ];
  }

  /** The state of each parcel; those in stock are counted. */
  parcelsOf(s) {
    const states = this.table.parcels.map(({ name }, p) => [name, this.table.parcel_states[s.parcel_state[p]]]);
    const waiting = states.filter(([, state]) => state === "in stock").length;
    return [...states.filter(([, state]) => state !== "in stock"), ...(waiting ? [["parcels in stock", `${waiting}`]] : [])];
  }

  factsOfCell(s, cell) {
    const facts = [
      ["state", this.table.cell_states[s.cell_state[cell]]],
      ["place", this.table.cells_m[cell].map(mm).join(", ")],
      ["sensors covered", s.cell_state[cell] < 2 ? "–" : this.table.sensors_m.map((_at, k) => s.cell_presence[cell] >> k & 1 ? k : null).filter((k) => k !== null).join(", ") || "none"],
    ];
    if (s.cell_promise[cell]) facts.push(["parcel", `${s.cell_promise[cell]}, ${NEAR[s.cell_promise_state[cell]]}`]);
    for (let axis = 0; axis < this.table.axes; axis++) {
      const w = cell * this.table.axes + axis, label = `axis ${axis + 1}`;
      facts.push([`${label} speed`, mm_s(s.wheel_speed[w])], [`${label} wanted`, mm_s(s.wheel_reference[w])]);
      if (Number.isFinite(s.wheel_normal[w])) facts.push([`${label} normal force`, newtons(s.wheel_normal[w])]);
      if (Number.isFinite(s.wheel_slip[w])) facts.push([`${label} slip`, mm_s(s.wheel_slip[w])]);
    }
    return facts;
  }

  factsOfParcel(s, p) {
    const believed = poseOf(s.parcel_believed, p), truth = poseOf(s.parcel_true, p), goal = poseOf(s.parcel_goal, p, true);
    const pose = (at) => at ? `${mm(at[0])}, ${mm(at[1])}, ${deg(at[2])}` : "–";
    const [xx, , yy, yaw] = s.parcel_spread.subarray(4 * p, 4 * p + 4);
    const facts = [["state", this.table.parcel_states[s.parcel_state[p]]], ["believed", pose(believed)]];
    if (xx >= 0) facts.push(["deviation", `${mm(Math.sqrt(xx))}, ${mm(Math.sqrt(yy))}, ${deg(Math.sqrt(yaw))}`]);
    if (this.table.true_known && !this.table.parcels[p].unknown) facts.push(["true", truth ? pose(truth) : this.placeOff(p)]);
    if (believed && truth) facts.push(["off by", `${mm(Math.hypot(believed[0] - truth[0], believed[1] - truth[1]))}, ${deg(believed[2] - truth[2])}`]);
    facts.push(["goal", pose(goal)]);
    if (believed && goal) facts.push(["to go", mm(Math.hypot(believed[0] - goal[0], believed[1] - goal[1]))]);
    return facts;
  }

  /** Where a parcel is that is not on the table. */
  placeOff(p) {
    const { name } = this.table.parcels[p];
    if (this.page.faults.ofParcel(name).length) return "in the hand";
    return this.table.stock.includes(name) ? "in stock" : "not on the table";
  }

  update(snapshot) {
    const facts = this.factsOf(snapshot);
    const names = facts.map(([name]) => name).join();
    if (names !== this.names) {
      this.names = names;
      this.cells = facts.map(() => make("td", { class: "value" }));
      this.facts.replaceChildren(make("table", {}, ...facts.map(([name], k) => make("tr", {}, make("th", { scope: "row" }, name), this.cells[k]))));
    }
    facts.forEach(([, value], k) => {
      if (this.cells[k].textContent !== value) this.cells[k].textContent = value;
    });
  }

  // Deeds

  showDeeds() {
    this.deeds.replaceChildren();
    if (!this.table) return;
    if (this.chosen?.kind === "cell") this.deeds.append(...this.deedsOfCell(this.chosen.number + 1));
    if (this.chosen?.kind === "parcel" && this.table.parcels[this.chosen.number]) {
      this.deeds.append(...this.deedsOfParcel(this.table.parcels[this.chosen.number]));
    }
    this.page.allow();
  }

  button(text, command, values) {
    return make("button", { type: "button", "data-moves": true, onclick: () => this.page.order(command, values()) }, text);
  }

  offers(command) { return this.table.offers.includes(command); }

  deedsOfCell(cell) {
    const buttons = [];
    if (this.offers("read_objects")) {
      buttons.push(make("button", { type: "button", "data-moves": true, onclick: () => this.readObjects(cell) }, "Read objects"));
    }
    if (!this.offers("fault")) return buttons;
    const fault = (text, values) => buttons.push(this.button(text, "fault", () => ({ fault: { cells: [cell], ...values } })));
    fault("Kill", { kind: "off" });
    fault("Hang", { kind: "hang" });
    buttons.push(make("button", { type: "button", "data-moves": true, onclick: () => this.page.revive(cell) }, "Revive"));
    fault("Sensors stuck covered", { kind: "sensor_stuck", covered: true });
    fault("Sensors stuck free", { kind: "sensor_stuck", covered: false });
    fault("Wheels jammed", { kind: "wheel_jammed" });
    fault("Cut off the bus", { kind: "cut" });
    return buttons;
  }

  deedsOfParcel(parcel) {
    const { name, unknown } = parcel;
    const parts = [];
    if (this.offers("goal") && !unknown) parts.push(this.poseForm("Set goal", name, (pose) => this.page.order("goal", { parcel: name, ...pose })));
    if (this.offers("fault") && !unknown) {
      parts.push(
        this.button("Lift", "fault", () => ({ fault: { kind: "lift", parcel: name } })),
        make("button", { type: "button", "data-moves": true, onclick: () => this.page.setDown(name) }, "Set down"),
        this.button("Push along x", "fault", () => ({ fault: { kind: "push", parcel: name, impulse_n_s: [0.3, 0] } })),
        this.button("Push along y", "fault", () => ({ fault: { kind: "push", parcel: name, impulse_n_s: [0, 0.3] } })),
      );
    }
    if (this.offers("name") && unknown) parts.push(this.nameForm(parcel));
    return parts;
  }

  poseForm(text, name, send) {
    const field = (label, step) => make("input", { name: label, type: "number", step, required: label !== "yaw [°]", "aria-label": `${label} of the goal of ${name}` });
    const [x, y, yaw] = [field("x [mm]", "any"), field("y [mm]", "any"), field("yaw [°]", "any")];
    const s = this.page.snapshot, p = this.chosen.number;
    const at = s && (poseOf(s.parcel_goal, p, true) ?? poseOf(s.parcel_believed, p));
    if (at) [x, y, yaw].forEach((input, k) => { input.value = Number.isNaN(at[k]) ? "" : +(at[k] * [1e3, 1e3, 180 / Math.PI][k]).toFixed(1); });
    return make("form", {
      onsubmit: (event) => {
        event.preventDefault();
        const turn = yaw.value === "" ? {} : { yaw_rad: yaw.valueAsNumber * Math.PI / 180 };
        send({ x_m: x.valueAsNumber / 1e3, y_m: y.valueAsNumber / 1e3, ...turn });
      },
    }, ...[x, y, yaw].map((input) => make("label", {}, input.name, input)), make("button", { "data-moves": true }, text));
  }

  /** What is unknown gets a name and an outline; what sensors show of it is proposed. */
  nameForm({ name: parcel, size, outline_m }) {
    const input = (label, attributes) => make("input", { required: true, "aria-label": label, ...attributes });
    const labelled = (text, element) => make("label", {}, text, element);
    const across = (axis) => Math.max(...outline_m.map((corner) => corner[axis])) - Math.min(...outline_m.map((corner) => corner[axis]));
    const whole = (value_m) => Math.round(1e3 * value_m);
    const proposed = size ? [whole(size.length_m), whole(size.width_m)] : [whole(across(0)), whole(across(1))];
    const name = input("Name of the parcel", {}), number = { type: "number", min: 1, step: "any" };
    const shape = make("select", { "aria-label": "Outline of the parcel" }, make("option", {}, "rectangle"), make("option", {}, "disc"));
    const [length, width] = ["length [mm]", "width [mm]"].map((label, k) => input(label, { ...number, value: proposed[k] }));
    const first = labelled("length [mm]", length), second = labelled("width [mm]", width);
    shape.addEventListener("change", () => {
      const round = shape.value === "disc";
      second.hidden = round;
      first.firstChild.data = round ? "diameter [mm]" : "length [mm]";
      length.setAttribute("aria-label", first.firstChild.data);
      length.value = round ? Math.round((across(0) + across(1)) * 500) : proposed[0];
    });
    const note = size ? `As sensors show it by now, to ${whole(2 * size.spread_m)} mm; edges show the rest as it moves.` : "No rectangle, as far as sensors show it.";
    return make("form", {
      onsubmit: (event) => {
        event.preventDefault();
        const mm = shape.value === "disc" ? [length, length] : [length, width];
        const [length_m, width_m] = mm.map((field) => field.valueAsNumber / 1e3);
        const untouched = shape.value !== "disc" && size && mm.every((field, k) => field.valueAsNumber === proposed[k]);
        const spread = untouched ? { spread_m: Math.max(size.spread_m, 0.0005) } : {};
        this.page.expected = name.value;
        this.page.order("name", { parcel, name: name.value, shape: shape.value, length_m, width_m, ...spread });
      },
    }, labelled("name", name), labelled("outline", shape), first, second, make("button", { "data-moves": true }, "Name it"), make("p", { class: "help" }, note));
  }

  // Objects

  async readObjects(cell) {
    this.rows = [];
    this.objects.replaceChildren(make("p", { class: "help" }, "reading …"));
    const answer = await this.page.order("read_objects", { cell });
    if (!answer.ok) this.objects.replaceChildren();
  }

  takeObjects({ cell, rows, over }) {
    if (this.chosen?.kind !== "cell" || this.chosen.number !== cell - 1) return;
    this.rows.push(...rows);
    this.objects.replaceChildren(
      make("h2", {}, over ? `Objects of cell ${cell}` : `Objects of cell ${cell}, reading …`),
      make("table", { "aria-label": `Objects of cell ${cell}` }, ...this.rows.map((row) => make("tr", {},
        make("td", { class: "number" }, row.place), make("th", { scope: "row" }, row.name), make("td", { class: "value" }, row.problem ?? row.text)))),
    );
  }
}
