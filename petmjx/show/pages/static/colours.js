// The meaning of colours: for each way of colouring, the colours of boxes at a time, and a legend.

import { make, makeSvg } from "./dom.js";
import { NO_ARTICLE } from "./texts.js";
import { clamped } from "./vectors.js";

const NOT_KNOWN = "#8a8f98";

// "#rrggbb" as shares from 0 to 1
export const rgbOf = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

// A round number at least as large: 1, 2 or 5 times a power of ten.
export function roundedUp(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((factor) => factor * power).find((round) => round >= value * 0.999);
}

export function shareOf(values, share) {
  const sorted = Float32Array.from(values).filter((value) => !Number.isNaN(value)).sort();
  return sorted.length ? sorted[Math.floor(share * (sorted.length - 1))] : 0;
}

// Ways of colouring by their keys: {title, colours(time) → flat rgb, legend() → element}.
export function colourings(info, frames) {
  const { boxes, limits, ramp } = info;
  const n = boxes.article.length;
  const scale = ramp.map(rgbOf);
  const nothing = rgbOf(NOT_KNOWN);

  const painted = (of) => {
    const out = new Float32Array(3 * n);
    for (let box = 0; box < n; box++) out.set(of(box), 3 * box);
    return out;
  };
  const onScale = (value, low, high) => {
    if (value === null || Number.isNaN(value)) return nothing;
    return scale[Math.round(clamped((value - low) / (high - low || 1), 0, 1) * (scale.length - 1))];
  };
  const number = (title, values, low, high, unit, limit = null) => ({
    title,
    colours: (time) => {
      const now = values(time);
      return painted((box) => onScale(now[box], low, high));
    },
    legend: () => scaleLegend(ramp, low, high, unit, limit),
  });
  const frameValues = (name) => (time) => frames.values(name, time);
  const articles = boxes.colour.map(rgbOf);
  const order = boxes.article.map((_, box) => box);
  const force = shareOf(frames.force_n, 1) || 1;
  return {
    article: { title: "article", colours: () => painted((box) => articles[box]), legend: () => articleLegend(boxes) },
    order: number("packing order", () => order, 0, Math.max(n - 1, 1), "packing order, from 0"),
    shift: number("shift", frameValues("shift_mm"), 0, 2 * limits.shift_mm, "shift, mm", limits.shift_mm),
    tilt: number("tilt", frameValues("tilt_deg"), 0, 2 * limits.tilt_deg, "tilt, °", limits.tilt_deg),
    force: number("force on top", frameValues("force_n"), 0, force, "force on top, N"),
  };
}

function articleLegend(boxes) {
  const counts = new Map();
  boxes.article.forEach((article, box) => {
    const entry = counts.get(article) || { colour: boxes.colour[box], count: 0 };
    entry.count += 1;
    counts.set(article, entry);
  });
  const ranked = [...counts].sort((a, b) => b[1].count - a[1].count);
  const item = ([article, { colour, count }]) => {
    const swatch = makeSvg("svg", { class: "swatch", viewBox: "0 0 1 1", "aria-hidden": "true" });
    swatch.append(makeSvg("rect", { width: 1, height: 1, fill: colour }));
    const name = article || NO_ARTICLE;
    return make("li", {}, swatch, make("span", {}, count > 1 ? `${name} (${count})` : name));
  };
  return make("ul", { tabindex: "0", "aria-label": "Colours of articles" }, ...ranked.map(item));
}

function scaleLegend(ramp, low, high, unit, limit) {
  const bar = makeSvg("svg", { viewBox: `0 0 ${ramp.length} 8`, preserveAspectRatio: "none", "aria-hidden": "true" });
  bar.setAttribute("shape-rendering", "crispEdges");
  ramp.forEach((fill, k) => bar.append(makeSvg("rect", { x: k, width: 1.05, height: 8, fill })));
  if (limit !== null) {
    const x = ((limit - low) / (high - low)) * ramp.length;
    bar.append(makeSvg("line", { x1: x, x2: x, y1: 0, y2: 8, stroke: "#fff", "stroke-width": 0.7 }));
  }
  const middle = limit === null ? "" : `limit ${limit.toPrecision(3).replace(/\.?0+$/, "")}`;
  const end = Number(high.toPrecision(3)).toLocaleString("en");
  const most = limit === null ? end : `≥ ${end}`; // only scales with a limit end before the largest value
  const numbers = [`${low}`, middle, most].map((text) => make("span", {}, text));
  return make("div", {}, make("div", { class: "small faint" }, unit), bar, make("div", { class: "scale" }, ...numbers));
}
