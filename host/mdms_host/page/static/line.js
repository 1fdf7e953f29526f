// The table as a machine of a line: its state, its orders and its counters.

import { make } from "./details.js";

export class LinePanel {
  constructor() {
    this.chip = document.getElementById("machine");
    this.tab = document.getElementById("tab-line");
    this.panel = document.getElementById("line");
  }

  /** A message `line`: the tab is there from the first one on. */
  take({ state, mode, reason, alarm, counters, orders }) {
    this.tab.hidden = this.chip.hidden = false;
    this.chip.textContent = state;
    this.chip.className = `chip ${{ Execute: "running", Aborted: "failed", Aborting: "failed", Held: "held", Suspended: "held" }[state] ?? ""}`;
    this.chip.title = reason;
    this.panel.replaceChildren(
      make("h2", {}, state),
      make("p", { class: "help" }, [mode, alarm?.text !== reason && reason].filter(Boolean).join(" · ")),
      ...(alarm ? [make("p", { class: "trouble" }, alarm.text), make("p", { class: "advice" }, [alarm.cause !== alarm.text && alarm.cause, alarm.cure].filter(Boolean).join(" · "))] : []),
      make("table", {}, make("tbody", {}, ...counters.map(([name, value]) => make("tr", {}, make("th", { scope: "row" }, name), make("td", { class: "number" }, String(value)))))),
      make("h2", {}, orders.length ? "Orders" : "No orders"),
      ...(orders.length ? [make("table", { "aria-label": "Orders" },
        make("thead", {}, make("tr", {}, ...["Key", "Parcel", "To", "State"].map((name) => make("th", { scope: "col" }, name)))),
        make("tbody", {}, ...orders.map((order) => make("tr", {}, ...order.map((value) => make("td", {}, value))))))] : []));
  }
}
