// The events: newest first, filtered by text, troubles with what to do. Events of one kind that
// follow each other are one line with their number, which opens to all of them.

import { make } from "./details.js";

const MOST = 500;
/** An event joins one of its kind that is among so many of the newest lines. */
const NEAR = 8;

const NUMBER = /[-\u2212]?\d[\d.,]*/g;

export class Events {
  /** `seek(time_s)` is called for an event that is clicked on, where there is such a thing. */
  constructor(seek) {
    this.seek = seek;
    this.list = document.getElementById("event-list");
    this.filter = document.getElementById("filter");
    this.only = document.getElementById("only-troubles");
    this.badge = document.getElementById("troubles");
    this.events = [];
    this.groups = [];
    this.names = [];
    this.unseen = 0;
    this.filter.addEventListener("input", () => this.show());
    this.only.addEventListener("change", () => this.show());
  }

  take({ events, all }) {
    if (all) this.events = [];
    this.events = [...this.events, ...events].slice(-MOST);
    if (all) {
      this.show();
      return;
    }
    for (const event of events) if (this.passes(event)) this.add(event);
    while (this.list.childElementCount > MOST) {
      this.list.lastElementChild.remove();
      this.groups.pop();
    }
    this.unseen += events.filter((event) => event.trouble).length;
    this.mark();
  }

  /** Events of a kind say the same but for numbers, and for names of parcels. */
  kindOf({ what, text, trouble }) {
    const unnamed = this.names.reduce((said, name) => said.replaceAll(name, "#"), text);
    return `${what} ${Boolean(trouble)} ${unnamed.replace(NUMBER, "#")}`;
  }

  passes(event) {
    const words = this.filter.value.toLowerCase();
    const text = `${event.what} ${event.text}`.toLowerCase();
    return text.includes(words) && (!this.only.checked || event.trouble);
  }

  /** Adds an event to the newest lines, or to one of them. */
  add(event) {
    const kind = this.kindOf(event);
    const at = this.groups.slice(0, NEAR).findIndex((group) => group.kind === kind);
    const [group] = at < 0 ? [{ kind, events: [], line: make("li") }] : this.groups.splice(at, 1);
    group.events = [...group.events, event].slice(-MOST);
    group.count = (group.count ?? 0) + 1;
    this.groups.unshift(group);
    this.fill(group);
    this.list.prepend(group.line);
  }

  fill({ line, events, count }) {
    const event = events.at(-1), open = line.querySelector("details")?.open ?? false;
    line.replaceChildren(this.time(event.time_s), this.text(event, count),
      ...(event.advice ? [make("span", { class: "advice" }, event.advice)] : []),
      ...(count > 1 ? [this.earlier(events, open)] : []));
  }

  text(event, count) {
    const where = event.cell ? ` · cell ${event.cell}` : "";
    const times = count > 1 ? [make("b", { class: "count", "aria-label": `${count} times` }, `×${count}`), " "] : [];
    return make("span", { class: event.trouble ? "trouble" : "" }, ...times, event.text, " ", make("span", { class: "kind" }, `${event.what}${where}`));
  }

  /** Those before, which are listed once somebody asks for them. */
  earlier(events, open) {
    const list = make("ol");
    const fill = () => list.replaceChildren(...events.slice(0, -1).reverse().map((event) => make("li", {}, this.time(event.time_s), this.text(event, 1))));
    if (open) fill();
    return make("details", { open, ontoggle: (event) => { if (event.target.open) fill(); } }, make("summary", {}, "earlier"), list);
  }

  time(time_s) {
    const text = `${time_s.toFixed(3)} s`;
    if (!this.seeks) return make("time", {}, text);
    return make("time", {}, make("button", { type: "button", class: "link", "aria-label": `Go to ${text}`, onclick: () => this.seek(time_s) }, text));
  }

  show() {
    this.groups = [];
    this.list.replaceChildren();
    for (const event of this.events) if (this.passes(event)) this.add(event);
  }

  /** The number of troubles since somebody has looked. */
  mark() {
    this.badge.hidden = !this.unseen;
    this.badge.textContent = this.unseen;
    this.badge.setAttribute("aria-label", `${this.unseen} new troubles`);
  }

  seen() {
    this.unseen = 0;
    this.mark();
  }
}
