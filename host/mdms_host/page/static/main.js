// The page: joins the wire to the picture, the panels and the buttons.

import { Details } from "./details.js";
import { Events } from "./events.js";
import { Faults } from "./faults.js";
import { Hands } from "./hands.js";
import { History } from "./history.js";
import { LinePanel } from "./line.js";
import { Plots } from "./plots.js";
import { TablePicture } from "./table.js";
import { View } from "./view.js";
import { Unpacker, Wire } from "./wire.js";
import { showLegend } from "./legend.js";

const $ = (id) => document.getElementById(id);
const PANELS = ["details", "plots", "events", "line", "faults"];
/** Text changes no more often than can be read [ms]. */
const TEXT_MS = 100, PLOTS_MS = 250;
/** Cells that have not reported to be off after this do not do so any more [ms]. */
const STOPPED_MS = 3000;
/** Phases in which a program can be started, and that of a table which another program drives. */
const IDLE = ["no program", "stopped", "stopped after a fault"], OTHER_HOST = "another host drives";
/** A rate of fewer parcels would say little. */
const RATED = 10;

const whole = (value) => Math.round(value).toLocaleString("en");
/** The first few of a list, and how many there are besides. */
const shortList = (names) => names.length > 3 ? `${names.slice(0, 3).join(", ")} and ${names.length - 3} more` : names.join(", ");

class Page {
  constructor() {
    this.view = new View();
    this.picture = new TablePicture($("table"), this.view);
    this.history = new History();
    this.events = new Events((time_s) => this.order("seek", { time_s }));
    this.faults = new Faults(this);
    this.line = new LinePanel();
    this.details = new Details(this);
    this.hands = new Hands(this.picture, this);
    this.plots = new Plots($("plots"), this.history, (time_s) => this.order("seek", { time_s }));
    this.table = this.snapshot = this.plan = this.control = this.phase = null;
    this.stopping_ms = 0;
    this.dirty = false;
    this.text_ms = this.plots_ms = 0;
    this.listen();
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const setTheme = () => this.setTheme(localStorage.getItem("theme") ?? (dark.matches ? "dark" : "light"));
    dark.addEventListener("change", setTheme);
    setTheme();
    this.wire = new Wire({
      message: (message) => this.take(message),
      snapshot: (buffer) => this.show(buffer),
      state: (connected) => this.connected(connected),
    });
    requestAnimationFrame((now) => this.frame(now));
  }

  get mayMove() { return Boolean(this.control?.yours); }

  // What comes in

  take(message) {
    switch (message.kind) {
      case "table": this.setTable(message); break;
      case "events": this.events.take(message); break;
      case "faults": this.faults.take(message); break;
      case "line": this.line.take(message); break;
      case "objects": this.details.takeObjects(message); break;
      case "plan": this.plan = message; this.redraw(); break;
      case "control": this.control = message; this.showControl(); break;
      case "answer": if (!message.ok) this.say(message.text); break;
    }
  }

  /** A description; of the same table, when a parcel has come or gone, what is looked at stays. */
  setTable(table) {
    const before = this.table, same = before && before.title === table.title && before.columns === table.columns;
    const chosen = same ? this.picture.chosen : null;
    const held = this.hands.held?.parcel;
    // Its number is another parcel's by now, or nobody's.
    if (held !== undefined && !(same && table.parcels[held]?.name === before.parcels[held].name)) this.hands.drop();
    this.table = table;
    this.unpacker = new Unpacker(table);
    if (!same) this.snapshot = null;
    this.events.names = table.parcels.map(({ name }) => name).sort((a, b) => b.length - a.length);
    this.events.seeks = table.offers.includes("seek");
    table.true_known = table.simulated || table.recorded;
    $("title").textContent = document.title = table.title;
    if (!same) this.history.clear();
    this.picture.setTable(table, !same);
    this.details.setTable(table);
    this.choose(chosen?.kind === "parcel" ? this.sameParcel(before, chosen) : chosen);
    if (same) return;
    this.arrange(table);
    if (table.recorded) this.fetchRun();
  }

  sameParcel(before, { kind, number }) {
    const numberOf = (called) => this.table.parcels.findIndex(({ name }) => name === called);
    const same = numberOf(before.parcels[number]?.name), now = same < 0 ? numberOf(this.expected) : same;
    return now < 0 ? null : { kind, number: now };
  }

  /** Shows what this table offers, and nothing else. */
  arrange(table) {
    const offers = (command) => table.offers.includes(command);
    $("program-buttons").hidden = !offers("start");
    $("signal-form").hidden = !offers("signal");
    $("time-buttons").hidden = !offers("pause");
    $("step").hidden = !offers("step");
    $("scrub-label").hidden = !offers("seek");
    $("tab-faults").hidden = !offers("fault");
    $("show-true-label").hidden = !table.true_known;
    $("pace").hidden = !table.simulated;
    $("stop-all").hidden = !offers("stop_all");
    document.querySelectorAll("[data-tool=push], [data-tool=lift]").forEach((tool) => { tool.hidden = !offers("fault"); });
    document.querySelector(".tools").hidden = !offers("goal");
    $("heat").querySelector("[value=normal]").disabled = !table.true_known;
    $("scrub").max = table.duration_s ?? 1;
    this.showLegend();
    if (!$("plots").hidden) this.plots.build(table, this.picture.chosen);
  }

  async fetchRun() {
    const response = await fetch("api/history");
    if (!response.ok) return;
    const all = await response.arrayBuffer(), { size } = this.unpacker, snapshots = [];
    for (let start = 0; start + size <= all.byteLength; start += size) {
      const one = this.unpacker.unpack(all.slice(start, start + size));
      if (one) snapshots.push(one);
    }
    this.history.fill(snapshots);
    if (!$("plots").hidden) this.buildPlots();
  }

  show(buffer) {
    const snapshot = this.unpacker?.unpack(buffer);
    if (snapshot) {
      this.snapshot = snapshot;
      this.history.add(snapshot);
      this.dirty = true;
    }
    this.wire.seen();
  }

  connected(connected) {
    document.body.classList.toggle("gone", !connected);
    if (connected) return;
    // The table takes the hand for gone. A browser that wakes up must not go on with an old drag.
    this.hands.drop();
    this.control = null;
    $("phase").textContent = "the table is gone";
    $("phase").className = "chip gone";
    this.showControl();
  }

  // What goes out

  order(command, values = {}) { return this.wire.ask(command, values); }

  stopAll() {
    this.order("stop_all").then(({ ok, text }) => {
      if (ok) this.stopping_ms = performance.now();
      else this.say(`Stop all is not confirmed: ${text}`);
    });
  }

  /** How many cells are off since a stop, as long as that changes, and which do not answer. */
  showStop(s, now) {
    if (!this.stopping_ms) return;
    const names = this.table.cell_states, cells = [...s.cell_state].map((state) => names[state]);
    const off = cells.filter((state) => state === "ready" || state === "fault").length;
    const dumb = cells.flatMap((state, cell) => state === "off" || state === "silent" ? [this.details.cellName(cell)] : []);
    const heard = `Stop all: ${off} of ${cells.length} off`;
    const late = now - this.stopping_ms > STOPPED_MS;
    const missing = late && dumb.length ? `; ${shortList(dumb)} ${dumb.length > 1 ? "do" : "does"} not answer: cut the motors' power` : "";
    const running = cells.length - off - dumb.length;
    this.say(heard + (missing || (late && running ? `; ${running} still run: cut the motors' power` : "")));
    if (off === cells.length || late) this.stopping_ms = 0;
  }

  /** Something unknown is named before it is moved: its form is opened. */
  askName(parcel) {
    const { name } = this.table.parcels[parcel];
    this.choose({ kind: "parcel", number: parcel });
    this.turnTo("details");
    this.say(this.table.offers.includes("name") ? `${name} has no name yet: name it, then drag it` : `${name} is unknown, and is not moved`);
    document.querySelector("[aria-label='Name of the parcel']")?.focus();
  }

  async revive(cell) {
    const numbers = this.faults.of(cell);
    if (!numbers.length) this.say(`nothing is wrong with cell ${cell}`);
    for (const number of numbers) await this.order("end_fault", { number });
  }

  async setDown(parcel) {
    const numbers = this.faults.ofParcel(parcel);
    if (!numbers.length) this.say(`${parcel} is not lifted`);
    for (const number of numbers) await this.order("end_fault", { number });
  }

  // What is shown

  redraw() { this.dirty = true; }

  frame(now) {
    if (this.dirty) {
      this.dirty = false;
      this.picture.draw(this.snapshot, this.plan, this.hands.dragged);
      this.frames = (this.frames ?? 0) + 1;
    }
    if (this.snapshot && this.control && now - this.text_ms >= TEXT_MS) {
      this.text_ms = now;
      this.showTexts(this.snapshot);
    }
    if (this.snapshot && !$("plots").hidden && now - this.plots_ms >= PLOTS_MS) this.showPlots(now);
    requestAnimationFrame((next) => this.frame(next));
  }

  showPlots(now) {
    const whole = this.history.whole && this.plots_ms;
    this.plots_ms = now;
    if (whole) this.plots.mark(this.snapshot.time[0]);
    else this.plots.update(this.snapshot.time[0]);
  }

  showTexts(s) {
    const legend = `${this.picture.most.normal} ${this.picture.promised} ${this.picture.planned} ${this.picture.arrow_m_s}`;
    if (legend !== this.legend) {
      this.legend = legend;
      this.showLegend();
    }
    const text = (id, value) => { if ($(id).textContent !== value) $(id).textContent = value; };
    const phase = this.table.phases[s.phase[0]];
    text("phase", this.table.recorded ? "recording" : s.paused[0] ? `${phase}, paused` : phase);
    if (phase !== this.phase) {
      this.phase = phase;
      this.allow();
    }
    this.showStop(s, performance.now());
    this.showFlow(s);
    $("phase").className = `chip ${phase === "running" ? "running" : phase.includes("fault") ? "failed" : phase.includes("holding") ? "held" : ""}`;
    text("time", `${s.time[0].toFixed(1)} s`);
    text("load", Number.isFinite(s.bus_load[0]) ? `bus ${this.table.simulated ? "" : "≤ "}${(100 * Math.max(...s.bus_load)).toFixed(0)} %` : "no bus");
    $("load").title = this.table.simulated ? "load of the busiest bus" : "load of the busiest bus at most: each frame counts with the most stuff bits";
    text("pace", Number.isFinite(s.real_time_factor[0]) ? `${s.real_time_factor[0].toFixed(2)}×` : "–");
    text("pause", s.paused[0] ? (this.table.recorded ? "Play" : "Go on") : "Pause");
    if (!$("details").hidden) this.details.update(s);
    const seen = `The table from above: ${this.details.cellsOf(s)}`;
    if ($("table").getAttribute("aria-label") !== seen) $("table").setAttribute("aria-label", seen);
    if (this.table.recorded && document.activeElement !== $("scrub")) $("scrub").value = s.time[0];
    text("scrub-time", `${s.time[0].toFixed(2)} / ${(this.table.duration_s ?? 0).toFixed(2)} s`);
  }

  /** Parcels that have come and left; a rate is said of ten parcels or more, with its time. */
  showFlow(s) {
    const came = s.parcels_came[0], time_s = s.flow_time[0];
    $("flow").hidden = !Number.isFinite(came);
    if ($("flow").hidden) return;
    const left = s.parcels_left.reduce((sum, count) => sum + count, 0);
    const by = this.table.exits.map(({ name }, k) => `${name} ${s.parcels_left[k]}`).join(", ");
    const rate = left >= RATED ? ` in ${time_s.toFixed(0)} s: ${whole(3600 * left / time_s)} an hour` : "";
    const text = `${came} came, ${left} left${by && left ? ` (${by})` : ""}${rate}`;
    if ($("flow").textContent !== text) $("flow").textContent = text;
  }

  showControl() {
    const control = this.control, others = (control?.clients ?? 1) - 1;
    const who = !control ? "not connected" : control.yours ? "in control" : "watching";
    $("who").textContent = others > 0 ? `${who} · ${others} more` : who;
    $("take").hidden = !control?.may || control.yours;
    this.allow();
  }

  /** Buttons that move something work for the page in control only; every page with the token stops the program, and any stops all. */
  allow() {
    const may = this.mayMove, idle = IDLE.includes(this.phase);
    for (const id of ["pause", "step", "speed", "scrub"]) $(id).disabled = !may;
    $("start").disabled = !may || !idle;
    $("start").title = may && !idle ? (this.phase === OTHER_HOST ? "another host drives the cells" : "the program runs already") : "";
    $("stop").disabled = !this.control?.may;
    document.querySelectorAll("[data-moves]").forEach((button) => { button.disabled = !may; });
    document.querySelectorAll("[data-tool]").forEach((button) => { button.disabled = !may; });
    $("stop-all").disabled = !this.control;
  }

  say(text) {
    $("notice").textContent = text;
    clearTimeout(this.silence);
    this.silence = setTimeout(() => { $("notice").textContent = ""; }, 5000);
  }

  choose(chosen) {
    this.picture.chosen = chosen;
    this.details.choose(chosen);
    if (this.table && !$("plots").hidden) this.buildPlots();
    this.redraw();
  }

  buildPlots() {
    this.plots.build(this.table, this.picture.chosen);
    this.plots_ms = 0;
  }

  turnTo(panel) {
    for (const name of PANELS) {
      $(name).hidden = name !== panel;
      $(`tab-${name}`).setAttribute("aria-selected", name === panel);
      $(`tab-${name}`).tabIndex = name === panel ? 0 : -1;
    }
    if (panel === "plots" && this.table) this.buildPlots();
    else this.plots.clear();
    if (panel === "events") this.events.seen();
  }

  setTheme(theme) {
    document.documentElement.dataset.theme = theme;
    this.picture.readTheme();
    this.showLegend();
    if (this.table && !$("plots").hidden) this.buildPlots();
    this.redraw();
  }

  showLegend() { showLegend($("legend"), this.picture, this.table); }

  // Buttons and keys

  listen() {
    $("stop-all").addEventListener("click", () => this.stopAll());
    for (const id of ["start", "stop", "step"]) $(id).addEventListener("click", () => this.order(id));
    $("signal-form").addEventListener("submit", (event) => this.sendSignal(event));
    $("pause").addEventListener("click", () => this.order(this.snapshot?.paused[0] ? "resume" : "pause"));
    $("speed").addEventListener("change", () => this.order("speed", { factor: Number($("speed").value) }));
    $("scrub").addEventListener("input", () => this.order("seek", { time_s: Number($("scrub").value) }));
    $("take").addEventListener("click", () => this.order("take_control"));
    $("theme").addEventListener("click", () => this.changeTheme());
    $("heat").addEventListener("change", () => { this.picture.heat = $("heat").value; this.showLegend(); this.redraw(); });
    $("show-true").addEventListener("change", () => { this.picture.showTrue = $("show-true").checked; this.redraw(); });
    $("show-plan").addEventListener("change", () => { this.picture.showPlan = $("show-plan").checked; this.redraw(); });
    $("zoom-in").addEventListener("click", () => { this.view.zoom(1.25); this.redraw(); });
    $("zoom-out").addEventListener("click", () => { this.view.zoom(0.8); this.redraw(); });
    $("zoom-fit").addEventListener("click", () => { this.view.fit(this.table); this.redraw(); });
    document.querySelectorAll("[data-tool]").forEach((button) => button.addEventListener("click", () => this.setTool(button.dataset.tool)));
    PANELS.forEach((name) => $(`tab-${name}`).addEventListener("click", () => this.turnTo(name)));
    document.querySelector("[role=tablist]").addEventListener("keydown", (event) => this.walkTabs(event));
    window.addEventListener("keydown", (event) => this.key(event), true);
    new ResizeObserver(() => { this.picture.resize(); this.redraw(); }).observe($("table"));
    new ResizeObserver(() => this.plots.resize()).observe($("side"));
  }

  /** The space bar stops the table again once a signal is sent. */
  sendSignal(event) {
    event.preventDefault();
    this.order("signal", Object.fromEntries(new FormData(event.target)));
    document.activeElement.blur();
  }

  changeTheme() {
    const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    localStorage.setItem("theme", theme);
    this.setTheme(theme);
  }

  setTool(tool) {
    this.hands.tool = tool;
    document.querySelectorAll("[data-tool]").forEach((button) => button.setAttribute("aria-pressed", button.dataset.tool === tool));
  }

  walkTabs(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const shown = PANELS.filter((name) => !$(`tab-${name}`).hidden);
    const next = shown[(shown.findIndex((name) => !$(name).hidden) + step + shown.length) % shown.length];
    this.turnTo(next);
    $(`tab-${next}`).focus();
  }

  /** Space stops everything, but where a space is written; Enter does what space does elsewhere. */
  key(event) {
    const writes = event.target.matches?.("input:is(:not([type]), [type=text], [type=search])");
    if (event.key === "Enter" && event.target.matches?.("[type=checkbox]")) event.target.click();
    if (event.code !== "Space" || writes || !this.table?.offers.includes("stop_all")) return;
    event.preventDefault();
    event.stopPropagation();
    if (!event.repeat) this.stopAll();
  }
}

window.page = new Page();
