// What the colours and lines of the picture mean.

import { make } from "./details.js";
import { colourOf, heat } from "./table.js";

const TITLES = { slip: (most) => `${1e3 * most} mm/s slip`, normal: (most) => `${most} N on a wheel` };

export function showLegend(place, picture, table) {
  const parts = [];
  const swatch = (text, fill, edge) => {
    const box = make("i");
    box.style.background = fill;
    if (edge) box.style.borderColor = edge;
    parts.push(make("span", {}, box, text));
  };
  const line = (text, colour, style = "solid") => {
    const mark = make("i", { class: "line" });
    mark.style.borderTopColor = colour;
    mark.style.borderTopStyle = style;
    parts.push(make("span", {}, mark, text));
  };
  const colours = picture.colours;
  if (picture.heat === "state") {
    swatch("off or silent", colours.silent, colours["cell-line"]);
    swatch("ready", colours.cell, colours["cell-line"]);
    swatch("running", colours.running, colours["running-line"]);
    swatch("fault", colours.fault, colours["fault-line"]);
    swatch("suspected", colours.suspected, colours["suspected-line"]);
  } else {
    const strip = make("canvas", { width: 60, height: 12 }), context = strip.getContext("2d");
    for (let x = 0; x < 60; x++) {
      context.fillStyle = heat(x / 59);
      context.fillRect(x, 0, 1, 12);
    }
    parts.push(make("span", {}, "0", strip, TITLES[picture.heat](picture.most[picture.heat])));
  }
  line("believed", colours.parcel);
  if (!table?.recorded) line("with 95 %", colours.spread);
  if (table?.true_known) line("true", colours.true, "dashed");
  line("goal", colours.goal, "dotted");
  line(`wheel, half a cell: ${1e3 * picture.arrow_m_s} mm/s`, colours.wheel);
  line("wheel slips", colours.slip);
  if (picture.planned) line("way, and tiles reserved", colourOf(1), "dashed");
  if (picture.promised) line("cell near a parcel, promised, under it", "#c44e8a", "dotted");
  place.replaceChildren(...parts);
}
