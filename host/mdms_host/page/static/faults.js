// Faults of a simulated table: what is at work, and a form to have more.

import { make } from "./details.js";

/** What the form offers, and what it asks of each. */
const KINDS = {
  loss: ["frames get lost", "Frames of these cells get lost, each with this probability.", true],
  corruption: ["frames are damaged", "A bit of their frames is read wrong by all.", true],
  delay: ["frames leave late", "Their frames leave 1 ms late.", false],
  cut: ["the bus is cut", "The wire is cut between these cells and the rest.", false],
  off: ["cells lose power", "They start again at the end.", false],
  hang: ["cells hang", "Their watchdogs reset them at the end.", false],
  supply: ["the motors' supply fails", "Their motors have no supply, and their wheels coast.", false],
  "supply brake": ["the emergency stop is pressed", "Its contacts cut their motors off and short them.", false],
  bridge_fault: ["bridges shut off", "Their bridges report a fault.", false],
  sensor_stuck: ["sensors read covered", "Whatever lies over them.", false],
  encoder_stuck: ["encoders stand still", "They count no more.", false],
  wheel_jammed: ["wheels jam", "They stand, whatever the voltage.", false],
  motor_reversed: ["motors turn the other way", "Their encoders count as ever.", false],
  host: ["the host is gone", "The coordinator neither receives nor sends.", false],
};
const OF_NO_CELL = ["host"];

export class Faults {
  constructor(page) {
    this.page = page;
    this.list = document.getElementById("fault-list");
    this.form = document.getElementById("fault-form");
    this.help = document.getElementById("fault-help");
    this.faults = [];
    const { kind } = this.form.elements;
    kind.append(...Object.entries(KINDS).map(([value, [text]]) => make("option", { value }, text)));
    kind.addEventListener("change", () => this.explain());
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.begin();
    });
    this.form.querySelector("button").setAttribute("data-moves", "");
    this.explain();
  }

  explain() {
    const { kind, cells, probability } = this.form.elements, [, help, byShare] = KINDS[kind.value];
    this.help.textContent = help;
    probability.parentElement.hidden = !byShare;
    cells.parentElement.hidden = OF_NO_CELL.includes(kind.value);
  }

  begin() {
    const { kind, cells, probability, duration_s } = this.form.elements;
    const [name, brake] = kind.value.split(" ");
    const fault = { kind: name };
    if (brake) fault.brake = true;
    const numbers = cells.value.split(/[\s,]+/).filter(Boolean).map(Number);
    if (numbers.length && !OF_NO_CELL.includes(kind.value)) fault.cells = numbers;
    if (KINDS[kind.value][2]) fault.probability = probability.valueAsNumber;
    if (duration_s.value !== "") fault.duration_s = duration_s.valueAsNumber;
    this.page.order("fault", { fault });
  }

  take({ faults }) {
    this.faults = faults;
    this.list.replaceChildren(...faults.map(({ number, fault, since_s }) => {
      const text = textOf(fault);
      const end = make("button", { type: "button", "data-moves": true, "aria-label": `End: ${text}`, onclick: () => this.page.order("end_fault", { number }) }, "End");
      return make("li", {}, make("span", {}, `${text}, since ${since_s.toFixed(1)} s`), end);
    }));
    if (!faults.length) this.list.append(make("li", { class: "help" }, "none"));
    this.page.allow();
  }

  /** The numbers of the faults of one cell that end when it is revived. */
  of(cell) {
    return this.faults.filter(({ fault }) => fault.cells?.length === 1 && fault.cells[0] === cell).map(({ number }) => number);
  }

  ofParcel(name) { return this.faults.filter(({ fault }) => fault.kind === "lift" && fault.parcel === name).map(({ number }) => number); }
}

function textOf(fault) {
  const kind = fault.brake ? `${fault.kind} brake` : fault.kind;
  const what = kind === "lift" ? "lifted" : KINDS[kind]?.[0] ?? kind;
  const whom = fault.parcel ?? (fault.cells ? `${fault.cells.length > 1 ? "cells" : "cell"} ${fault.cells.join(", ")}` : "all");
  const share = fault.probability === undefined ? "" : ` (${(100 * fault.probability).toFixed(0)} %)`;
  return `${whom}: ${what}${share}`;
}
