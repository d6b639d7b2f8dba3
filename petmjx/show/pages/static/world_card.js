// The final state of one world in 3D, with the numbers of its boxes.
//
//   const card = new Card(info, run, first, world, replay);   card.element; card.start(); card.dispose()
//
// `run` is an entry of info.runs, `first` the box that failed first or −1, `world` from endedWorld in final_boxes.js,
// `replay` the number of its recorded history or −1.

import { rgbOf, shareOf } from "./colours.js";
import { make, makeSvg } from "./dom.js";
import { bounds } from "./final_boxes.js";
import { Replay } from "./replay.js";
import { decimals, goodsOf } from "./texts.js";
import { clamped, upright } from "./vectors.js";
import { createViewer } from "./viewer.js";

const COLOURS = { article: "article", moved: "movement", tilt: "largest tilt", force: "largest force on top" };
const UNITS = { moved: "mm", tilt: "°", force: "N" };
const UNPLACED = [0.6, 0.6, 0.6];

export class Card {
  constructor(info, run, first, world, replay) {
    Object.assign(this, { info, run, first, world, replay, chosen: -1 });
    this.canvas = make("canvas", { role: "img", "aria-label": `${run.name}: the pallet as it ended` });
    this.legend = make("div", { class: "legend faint small" });
    this.facts = make("p", { class: "small", role: "status" }, "Click a box for its numbers.");
    this.lines = Array.from({ length: world.n }, (_, box) => this.line(box));
    this.element = make("article", { class: "card3d" });
    if (info.runs.length > 1) this.element.append(make("h4", {}, run.name));
    this.element.append(this.canvas, this.controls(), this.legend, this.facts, this.table());
    if (run.nominalSizes) this.element.append(hint("Sizes are the plan’s; this world’s errors of size are not drawn."));
  }

  // Call this method when the element is in the page: before that, the canvas has no size, and cannot be drawn on.
  start() {
    this.viewer = createViewer(this.canvas, { ...this.world, floorZ: this.run.floorZ });
    if (!this.viewer) {
      this.canvas.replaceWith(hint("This browser has no WebGL 2: there is no picture, but all numbers are below."));
      return;
    }
    this.viewer.setPoses(this.world.pos, this.world.quat);
    this.viewer.frame(...bounds(this.world));
    this.viewer.onClick = (box) => this.choose(box);
    this.colour("article");
    this.mark();
    if (this.replay >= 0) {
      this.player = new Replay(this.replay, this.viewer);
      this.canvas.after(this.player.element);
    }
  }

  dispose() {
    this.player?.dispose();
    this.viewer?.dispose();
  }

  // ---- private

  controls() {
    const options = Object.entries(COLOURS).map(([value, label]) => make("option", { value }, label));
    const colours = make("select", { "aria-label": "Colour by" }, ...options);
    colours.addEventListener("change", () => this.colour(colours.value));
    const planned = make("input", { type: "checkbox" });
    planned.addEventListener("change", () => this.ghosts(planned.checked));
    const reset = make("button", { type: "button" }, "Reset view");
    reset.addEventListener("click", () => this.viewer?.reset());
    const ghosts = make("label", { class: "tick" }, planned, "as planned");
    return make("div", { class: "line" }, make("label", {}, "Colour ", colours), ghosts, reset);
  }

  ghosts(wanted) {
    if (wanted) this.viewer?.setGhosts(this.world.planned, upright(this.world.n));
    else this.viewer?.setGhosts();
  }

  colour(by) {
    const values = by === "article" ? null : this.world[by];
    const most = values ? this.most(by, values) : 0;
    const shades = values ? this.info.ramp : this.info.categories;
    const places = values ? null : ranked(this.world.article);
    const rgb = new Float32Array(3 * this.world.n);
    for (let box = 0; box < this.world.n; box++) {
      const onScale = () => Math.round(clamped(values[box] / most, 0, 1) * (shades.length - 1));
      const shade = values ? onScale() : places[box] % shades.length;
      rgb.set(shades[shade] ? rgbOf(shades[shade]) : UNPLACED, 3 * box);
    }
    this.viewer?.setColours(rgb);
    this.legend.replaceChildren(...(values ? scale(shades, most, by) : []));
  }

  // The end of a scale: twice the limit, so that all plans have the same scale; for forces the largest force, since
  // forces have no limit.
  most(by, values) {
    const { shift_mm, tilt_deg } = this.run.limits;
    if (by === "force") return shareOf(values, 1) || 1;
    return 2 * (by === "moved" ? shift_mm : tilt_deg);
  }

  mark() {
    const style = getComputedStyle(document.documentElement);
    const marks = [[this.first, "--first"], [this.chosen, "--accent"]].filter(([box]) => box >= 0);
    this.viewer?.setMarks(marks.map(([box, name]) => ({ box, colour: rgbOf(style.getPropertyValue(name).trim()) })));
  }

  choose(box) {
    this.lines[this.chosen]?.removeAttribute("aria-current");
    this.chosen = box;
    this.lines[box]?.setAttribute("aria-current", "true");
    this.lines[box]?.scrollIntoView({ block: "nearest" });
    this.facts.textContent = box < 0 ? "No box chosen." : this.said(box);
    this.mark();
  }

  said(box) {
    const { article, item, sides, mass, moved, tilt, force, rest, drop } = this.world;
    const first = box === this.first ? " – failed first" : "";
    const ended = Number.isNaN(moved[box])
      ? "was not placed"
      : `moved ${decimals(moved[box], 1)} mm, tilted up to ${decimals(tilt[box], 1)}°, ` +
        `up to ${decimals(force[box], 0)} N on top` +
        (Number.isNaN(rest[box]) ? "" : `, ${decimals(rest[box], 0)} N at rest`) +
        (Number.isNaN(drop[box]) ? "" : `, dropped at ${decimals(drop[box], 2)} s`);
    const size = sides[box].map((side) => decimals(side, 0)).join(" × ");
    const goods = goodsOf(article[box], item[box]);
    return `Box ${box}${first}: ${goods && `${goods}, `}${size} mm, ${decimals(mass[box], 2)} kg; ${ended}.`;
  }

  table() {
    const heads = ["box", "article", "mm", "kg", "moved mm", "tilt °", "force N", "at rest N", "dropped s"];
    const cells = heads.map((text, k) => make("th", { scope: "col", class: k === 1 ? "text" : "" }, text));
    const head = make("tr", {}, ...cells);
    const body = make("tbody", {}, ...this.lines);
    body.addEventListener("click", (event) => {
      const at = this.lines.indexOf(event.target.closest("tr"));
      if (at >= 0) this.choose(at);
    });
    const table = make("table", { class: "boxes" }, make("thead", {}, head), body);
    return make("div", { class: "wide boxes", tabindex: "0", role: "region", "aria-label": "Boxes" }, table);
  }

  line(box) {
    const { article, sides, mass, moved, tilt, force, rest, drop } = this.world;
    const size = sides[box].map((side) => decimals(side, 0)).join("×");
    const numbers = [[moved, 1], [tilt, 1], [force, 0], [rest, 0], [drop, 2]];
    const button = make("button", { type: "button", class: "flat" }, String(box));
    const line = make("tr", {}, make("th", { scope: "row" }, button), make("td", { class: "text" }, article[box]));
    line.append(make("td", {}, size), make("td", {}, decimals(mass[box], 2)));
    line.append(...numbers.map(([values, digits]) => make("td", {}, decimals(values[box], digits))));
    if (box === this.first) line.className = "first";
    return line;
  }
}

function hint(text) {
  return make("p", { class: "hint" }, text);
}

// For each box, the rank of its article, from 0. The article with the most boxes comes first.
function ranked(articles) {
  const counts = new Map();
  for (const article of articles) counts.set(article, (counts.get(article) ?? 0) + 1);
  const order = [...counts.keys()].sort((a, b) => counts.get(b) - counts.get(a));
  return articles.map((article) => order.indexOf(article));
}

// A bar with all shades, between the labels of its ends.
function scale(shades, most, by) {
  const box = { viewBox: `0 0 ${shades.length} 1`, preserveAspectRatio: "none", "aria-hidden": "true" };
  const bar = makeSvg("svg", { class: "ramp", ...box });
  shades.forEach((fill, x) => bar.append(makeSvg("rect", { x, y: 0, width: 1.05, height: 1, fill })));
  const end = `${Number(most.toPrecision(3)).toLocaleString("en")} ${UNITS[by]}`;
  return [`0 ${UNITS[by]}`, bar, by === "force" ? end : `≥ ${end}`];
}
