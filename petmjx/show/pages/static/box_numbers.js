// Shows the numbers of one box: its data from the plan, and its state at the time that is shown.

import { make } from "./dom.js";
import { decimals } from "./texts.js";

const fixed = (value, digits, unit) => decimals(value, digits) + (Number.isFinite(value) ? ` ${unit}` : "");

// Fills a definition list.
export function showNumbers(list, box, info, frames, time) {
  if (box < 0) {
    list.replaceChildren(make("dt", {}, "none chosen"), make("dd", { class: "faint" }, "click one"));
    return;
  }
  const { boxes, limits } = info;
  const now = (name) => frames.values(name, time)[box];
  const shift = now("shift_mm");
  const tilt = now("tilt_deg");
  const rows = [
    ["article", boxes.article[box] || "–"],
    ["item", boxes.item[box] || "–"],
    ["size", `${boxes.size_mm[box].join(" × ")} mm`],
    ["mass", fixed(boxes.mass_kg[box], 2, "kg")],
    ["packed as", `${box} of ${boxes.article.length}, from 0`],
    ["in the order", `${boxes.sequence[box]}`],
    ["placed at", fixed(boxes.placed_s[box], 2, "s")],
    ["shift now", fixed(shift, 1, "mm"), shift > limits.shift_mm],
    ["tilt now", fixed(tilt, 1, "°"), tilt > limits.tilt_deg],
    ["force on top now", fixed(now("force_n"), 1, "N")],
    ["at rest", fixed(boxes.rest_force_n[box], 1, "N")],
    ["largest", fixed(boxes.max_force_n[box], 1, "N")],
    ["dropped at", fixed(boxes.drop_s[box], 2, "s"), boxes.drop_s[box] !== null],
  ];
  if (info.first && info.first.box === box) rows.push(["first sign", fixed(info.first.time, 2, "s"), true]);
  list.replaceChildren(
    ...rows.flatMap(([name, value, over]) => [make("dt", {}, name), make("dd", over ? { class: "over" } : {}, value)]),
  );
}
