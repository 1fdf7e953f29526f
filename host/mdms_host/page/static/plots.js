// The plots: each a list of lines over the history, drawn by uPlot.

/* global uPlot */

const HEIGHT = 118;
const LINES = ["#2f7fd6", "#bb6e21", "#3d9a5f", "#b0459a", "#8a6d3b", "#7579d0", "#d7584b", "#2a9d9d", "#777f8c", "#86860c"];
const turned = (angle) => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));

/** Why a plot may have no lines. */
const NO_LOG = "The run has no bus log.";
const NO_ERRORS = "Bus logs have whole frames only, and not every CAN interface reports error frames.";
const NO_COUNTERS = "The nodes' own: no frame has them, so they are shown while a simulation runs.";
const NO_BELIEF = "No coordinator has believed anything of this parcel.";
const NO_DEVIATION = "A run has no deviations of beliefs.";
const NO_JITTER = "A run has the table's time, and not the machine's.";

/**
 * The plots of a table: title, unit, and lines as [label, value of a snapshot, colour if it is
 * another's too, "dashed"]; `usual`: a few values that are much higher do not set the scale.
 */
function plotsOf(table, chosen, parcel) {
  const buses = [...Array(table.bus_count).keys()];
  const named = (text, bus) => table.bus_count > 1 ? `${text} ${bus}` : text;
  const sum = (array, from, step) => {
    let total = 0;
    for (let k = from; k < array.length; k += step) total += array[k];
    return total;
  };
  const kinds = table.frame_kinds.length;
  const wheels = [], bus = [
    { title: table.simulated ? "Bus load" : "Bus load at most", unit: "%", low: [0, 20], lacks: NO_LOG, lines: buses.map((b) => [named("bus", b), (s) => 100 * s.bus_load[b]]) },
    { title: "Error frames", unit: "1/s", low: [0, 4], lacks: NO_ERRORS, lines: buses.map((b) => [named("bus", b), (s) => s.bus_error_rate[b]]) },
    {
      title: "Error counters, the highest of any node", unit: "", low: [0, 8], lacks: NO_COUNTERS,
      lines: buses.flatMap((b) => [
        [named("transmit", b), (s) => s.bus_counters[2 * b], b],
        [named("receive", b), (s) => s.bus_counters[2 * b + 1], b, "dashed"],
      ]),
    },
    {
      title: "Frames by kind", unit: "1/s", low: [0, 100], lacks: NO_LOG,
      lines: table.frame_kinds.map((kind, k) => [kind, (s) => sum(s.bus_frames, k, kinds)]),
    },
  ];
  const cell = chosen?.kind === "cell" ? chosen.number : null;
  if (cell !== null) {
    const lines = [];
    for (let axis = 0; axis < table.axes; axis++) {
      const w = cell * table.axes + axis;
      lines.push([`axis ${axis + 1}`, (s) => 1e3 * s.wheel_speed[w], axis]);
      lines.push([`axis ${axis + 1} wanted`, (s) => 1e3 * s.wheel_reference[w], axis, "dashed"]);
    }
    wheels.push({ title: `Wheels of cell ${cell + 1}`, unit: "mm/s", lines });
  } else {
    wheels.push({
      title: "Fastest wheel, and fastest wanted", unit: "mm/s", low: [0, 20],
      lines: [
        ["speed", (s) => 1e3 * most(s.wheel_speed), 0],
        ["wanted", (s) => 1e3 * most(s.wheel_reference), 0, "dashed"],
      ],
    });
  }
  if (table.parcels[parcel]) {
    const { name } = table.parcels[parcel], at = 3 * parcel;
    const other = table.true_known ? "parcel_true" : "parcel_goal";
    const title = table.true_known ? `Belief less truth, ${name}` : `Belief less goal, ${name}`;
    const off = (k, scale) => (s) => scale * (s.parcel_believed[at + k] - s[other][at + k]);
    wheels.push({ title, unit: "mm", lacks: NO_BELIEF, partly: NO_DEVIATION, lines: [["x", off(0, 1e3)], ["y", off(1, 1e3)],
      ["deviation", (s) => 1e3 * Math.sqrt(Math.max(s.parcel_spread[4 * parcel], s.parcel_spread[4 * parcel + 2]))]] });
    wheels.push({ title: `${title}: yaw`, unit: "°", lacks: NO_BELIEF, lines: [
      ["yaw", (s) => turned(s.parcel_believed[at + 2] - s[other][at + 2]) * 180 / Math.PI]] });
  }
  bus.push({ title: "Cycle jitter", unit: "ms", low: [0, 1], usual: true, lacks: NO_JITTER, lines: [["late by", (s) => 1e3 * s.jitter[0]]] });
  return [...wheels, ...bus];
}

function most(values) {
  let found = 0;
  for (const value of values) if (Math.abs(value) > found) found = Math.abs(value);
  return found;
}

export class Plots {
  constructor(place, history, onSeek) {
    this.place = place;
    this.history = history;
    this.onSeek = onSeek;
    this.drawn = [];
    this.lacking = [];
  }

  /** Sets up the plots for what is chosen; colours are read again. One of which nothing is known says why. */
  build(table, chosen) {
    this.clear();
    Object.assign(this, { table, chosen, parcel: this.parcelOf(table, chosen) });
    const style = getComputedStyle(document.documentElement);
    const text = style.getPropertyValue("--faint").trim(), line = style.getPropertyValue("--line").trim();
    for (const plot of plotsOf(table, chosen, this.parcel)) {
      const box = document.createElement("section");
      box.className = "plot";
      const head = document.createElement("h2");
      head.textContent = plot.unit ? `${plot.title} [${plot.unit}]` : plot.title;
      box.append(head);
      box.setAttribute("aria-label", head.textContent);
      this.place.append(box);
      if (this.isKnown(plot)) {
        // In a recorded run lines of which nothing is known are left out.
        const known = plot.lines.filter((one) => !this.history.whole || this.isKnown({ lines: [one] }));
        if (known.length < plot.lines.length && plot.partly) this.say(box, plot.partly);
        plot.lines = known;
        this.drawn.push({ plot, chart: this.chart(box, plot, text, line) });
      } else {
        this.say(box, plot.lacks ?? "Nothing is known of it.");
        this.lacking.push(plot);
      }
    }
  }

  /** The chosen parcel; else the one that is shown while it is there, then the first that is; of a recorded run, ever. */
  parcelOf(table, chosen) {
    if (chosen?.kind === "parcel") return chosen.number;
    const there = (p) => p !== undefined && this.isKnown({ lines: [["", (s) => s.parcel_believed[3 * p]]] });
    const last = table === this.table ? this.parcel : undefined;
    if (there(last)) return last;
    const first = table.parcels.findIndex((_, p) => there(p));
    return first < 0 ? last ?? 0 : first;
  }

  say(box, reason) {
    const line = document.createElement("p");
    line.className = "help";
    line.textContent = reason;
    box.append(line);
  }

  /** Whether there is anything to draw: in a recorded run ever, else now. */
  isKnown({ lines }) {
    const { snapshots, whole } = this.history, seen = whole ? snapshots : snapshots.slice(-1);
    return !seen.length || seen.some((one) => lines.some(([, value]) => Number.isFinite(value(one))));
  }

  chart(box, plot, text, line) {
    const axis = { stroke: text, grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1 }, font: "11px system-ui" };
    const low = plot.low ?? [-1, 1];
    return new uPlot({
      width: this.width, height: HEIGHT,
      scales: {
        x: { time: false },
        y: { range: (chart, least, largest) => spanOf(least, plot.usual ? usualOf(chart.data[1]) : largest, low) },
      },
      axes: [{ ...axis, size: 26, values: (_chart, splits) => splits.map((t) => `${+t.toFixed(2)} s`) }, { ...axis, size: 46, space: 18 }],
      cursor: { drag: { x: false, y: false }, points: { show: false } },
      legend: { live: true, markers: { dash: (_chart, k) => plot.lines[k - 1]?.[3] ?? "solid" } },
      series: [
        { label: "time", value: (_chart, time) => time == null ? "–" : `${time.toFixed(2)} s` },
        ...plot.lines.map(([label, , colour, dashed], k) => ({
          label, stroke: LINES[(colour ?? k) % LINES.length], width: dashed ? 1.2 : 1.6,
          dash: dashed ? [4, 3] : undefined, points: { show: false },
          value: (_chart, value) => value == null ? "–" : readable(value),
        })),
      ],
      hooks: { draw: [(chart) => this.drawNow(chart, text)], ready: [(chart) => this.listen(chart)] },
    }, [[], ...plot.lines.map(() => [])], box);
  }

  /** A line at the time that is shown, in a recorded run. */
  drawNow(chart, colour) {
    if (!this.history.whole || this.now === undefined) return;
    const x = chart.valToPos(this.now, "x", true), { top, height } = chart.bbox;
    chart.ctx.strokeStyle = colour;
    chart.ctx.setLineDash([]);
    chart.ctx.lineWidth = 2;
    chart.ctx.beginPath();
    chart.ctx.moveTo(x, top);
    chart.ctx.lineTo(x, top + height);
    chart.ctx.stroke();
  }

  listen(chart) {
    chart.over.addEventListener("click", (event) => {
      if (this.history.whole) this.onSeek(chart.posToVal(event.offsetX, "x"));
    });
  }

  get width() { return Math.max(240, this.place.clientWidth - 26); }

  resize() {
    for (const { chart } of this.drawn) chart.setSize({ width: this.width, height: HEIGHT });
  }

  update(now) {
    this.now = now;
    const isOther = !this.history.whole && this.parcel !== this.parcelOf(this.table, this.chosen);
    if (isOther || (!this.history.whole && this.lacking.some((plot) => this.isKnown(plot)))) this.build(this.table, this.chosen);
    const times = this.history.times;
    for (const { plot, chart } of this.drawn) {
      chart.setData([times, ...plot.lines.map(([, value]) => this.history.series(value))]);
    }
    this.showValues();
  }

  /** The values at the time that is shown, the latest of a table that lives; under a pointer, those there. */
  showValues() {
    const times = this.history.times;
    let idx = times.length - 1;
    while (this.history.whole && idx > 0 && times[idx] > this.now) idx--;
    for (const { chart } of this.drawn) if (!(chart.cursor.left >= 0) && idx >= 0) chart.setLegend({ idx });
  }

  /** Moves the line of a recorded run without drawing its lines anew. */
  mark(now) {
    this.now = now;
    for (const { chart } of this.drawn) chart.redraw(false);
    this.showValues();
  }

  clear() {
    for (const { chart } of this.drawn) chart.destroy();
    this.drawn = [];
    this.lacking = [];
    this.place.replaceChildren();
  }
}

/** Three digits that count, and no power of ten. */
function readable(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2).replace(/^-(?=[0.]+$)/, "");
}

/** What all but a twentieth of the values stay below. */
function usualOf(values) {
  const known = values.filter((value) => value != null).sort((a, b) => a - b);
  return known.length ? 1.5 * known[Math.floor(0.95 * (known.length - 1))] : 0;
}

/** The range of an axis: at least `low`, with some air, and never of no height. */
function spanOf(least, largest, low) {
  if (least == null) return low;
  const from = Math.min(least, low[0]), to = Math.max(largest, low[1]);
  const air = 0.05 * (to - from);
  return [from < 0 ? from - air : from, to + air];
}
