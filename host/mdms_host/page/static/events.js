// The events: newest first, filtered by text, troubles with what to do.

import { make } from "./details.js";

const MOST = 500;

export class Events {
  /** `seek(time_s)` is called for an event that is clicked on, where there is such a thing. */
  constructor(seek) {
    this.seek = seek;
    this.list = document.getElementById("event-list");
    this.filter = document.getElementById("filter");
    this.only = document.getElementById("only-troubles");
    this.badge = document.getElementById("troubles");
    this.events = [];
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
    for (const event of events) if (this.passes(event)) this.list.prepend(this.line(event));
    while (this.list.childElementCount > MOST) this.list.lastElementChild.remove();
    this.unseen += events.filter((event) => event.trouble).length;
    this.mark();
  }

  passes(event) {
    const words = this.filter.value.toLowerCase();
    const text = `${event.what} ${event.text}`.toLowerCase();
    return text.includes(words) && (!this.only.checked || event.trouble);
  }

  line(event) {
    const where = event.cell ? ` · cell ${event.cell}` : "";
    return make("li", {},
      this.time(event.time_s),
      make("span", { class: event.trouble ? "trouble" : "" }, event.text, " ", make("span", { class: "kind" }, `${event.what}${where}`)),
      ...(event.advice ? [make("span", { class: "advice" }, event.advice)] : []));
  }

  time(time_s) {
    const text = `${time_s.toFixed(3)} s`;
    if (!this.seeks) return make("time", {}, text);
    return make("time", {}, make("button", { type: "button", class: "link", "aria-label": `Go to ${text}`, onclick: () => this.seek(time_s) }, text));
  }

  show() {
    this.list.replaceChildren(...this.events.filter((event) => this.passes(event)).reverse().map((event) => this.line(event)));
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
