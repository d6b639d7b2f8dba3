// The page of one story (petmjx/show/pages/story_page.py): joins viewer, player, time line, colours and numbers.

import { contactArrows, driveArrows } from "./arrows.js";
import { hasBlock, readBlock, readInfo } from "./page_data.js";
import { colourings, rgbOf } from "./colours.js";
import { byId, make } from "./dom.js";
import { Frames } from "./frames.js";
import { listenToKeys } from "./keys.js";
import { showNumbers } from "./box_numbers.js";
import { Player, SPEEDS } from "./player.js";
import { labelOf } from "./texts.js";
import { Timeline } from "./timeline.js";
import { clamped, upright } from "./vectors.js";
import { createViewer } from "./viewer.js";

const GLASS = 0.22; // opacity of boxes while arrows of contact forces are shown
const LABEL_GAP = 6; // pixels
const CHOSEN = { light: "#111418", dark: "#ffffff" };

class StoryPage {
  constructor(info, frames, viewer) {
    Object.assign(this, { info, frames, viewer, chosen: info.first ? info.first.box : -1 });
    this.night = matchMedia("(prefers-color-scheme: dark)");
    this.drive = info.drive && driveArrows(info, frames);
    this.colourings = colourings(info, frames);
    this.player = new Player(frames, (time) => this.show(time), (playing) => this.showPlaying(playing));
    this.timeline = new Timeline(info, frames, this.drive && this.drive.level, (time) => this.player.seek(time));
    this.fillLists();
    this.listen();
    viewer.onClick = (box) => this.choose(box);
    viewer.onDraw = () => this.placeLabels();
    viewer.frame(info.frame.low, info.frame.high);
    this.choose(this.chosen);
    this.showColours();
    this.player.go(this.firstSign() ?? frames.end);
  }

  fillLists() {
    const { boxes } = this.info;
    const option = (value, text) => make("option", { value }, text);
    byId("box").append(option(-1, "none"), ...boxes.article.map((article, box) => option(box, labelOf(box, article))));
    byId("speed").append(...SPEEDS.map((speed) => option(speed, `${speed}×`)));
    byId("speed").value = this.player.speed;
    for (const [key, { title }] of Object.entries(this.colourings)) byId("colour").append(option(key, title));
    byId("forces").disabled = !hasBlock("contacts");
    if (!hasBlock("contacts")) byId("force-scale").textContent = "(not recorded)";
    byId("to-sign").hidden = this.firstSign() === null;
    this.rows = [...document.querySelectorAll("#all tbody tr")];
    for (const { cells: [head] } of this.rows) {
      head.replaceChildren(make("button", { type: "button", class: "flat" }, head.textContent));
    }
  }

  listen() {
    const { player } = this;
    const on = (id, name, act) => byId(id).addEventListener(name, act);
    on("play", "click", () => player.toggle());
    on("back", "click", () => player.step(-1));
    on("forth", "click", () => player.step(1));
    on("to-start", "click", () => player.seek(this.frames.start));
    on("to-end", "click", () => player.seek(this.frames.end));
    on("to-sign", "click", () => this.toSign());
    on("speed", "change", (event) => (player.speed = Number(event.target.value)));
    on("colour", "change", () => this.showColours());
    on("ghosts", "change", () => this.showGhosts());
    on("forces", "change", () => this.showForces());
    on("box", "change", (event) => this.choose(Number(event.target.value)));
    on("all", "click", (event) => {
      const row = this.rows.indexOf(event.target.closest("tr"));
      if (row >= 0) this.choose(row);
    });
    this.night.addEventListener("change", () => this.choose(this.chosen));
    listenToKeys({
      player,
      viewer: this.viewer,
      toSign: () => this.toSign(),
      faster: (by) => this.faster(by),
      choose: (box) => this.choose(box),
    });
  }

  firstSign() {
    return this.info.first ? this.info.first.time : null;
  }

  toSign() {
    if (this.firstSign() !== null) this.player.seek(this.firstSign());
  }

  faster(by) {
    const place = SPEEDS.indexOf(this.player.speed) + by;
    this.player.speed = SPEEDS[clamped(place, 0, SPEEDS.length - 1)];
    byId("speed").value = this.player.speed;
  }

  show(time) {
    const { frames, viewer } = this;
    const frame = frames.at(time);
    frames.showIn(viewer, time);
    viewer.setColours(this.colouring.colours(time));
    const forces = this.contacts && byId("forces").checked;
    viewer.setOpacity(forces ? GLASS : 1);
    viewer.setArrows([...(forces ? this.contacts.at(frame) : []), ...(this.drive ? this.drive.at(frame) : [])]);
    if (this.drive) {
      byId("shaken").hidden = false;
      byId("shaken").textContent = this.drive.words(frame);
    }
    const n = this.info.boxes.article.length;
    const words = `${time.toFixed(2)} of ${frames.end.toFixed(2)} s, ${frames.placed[frame]} of ${n} boxes placed`;
    byId("now").textContent = words;
    this.timeline.show(time, words);
    showNumbers(byId("numbers"), this.chosen, this.info, frames, time);
  }

  // There may be millions of contacts, so they are only read on demand.
  async showForces() {
    this.contacts ??= contactArrows(await readBlock("contacts"), this.frames);
    byId("force-scale").textContent = `0.2 m of arrow: ${this.contacts.scale_n.toLocaleString("en")}\u00a0N`;
    this.show(this.player.time);
  }

  showPlaying(playing) {
    byId("play").classList.toggle("playing", playing);
    byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    byId("play-text").textContent = playing ? "Pause" : "Play";
  }

  get colouring() {
    return this.colourings[byId("colour").value];
  }

  showColours() {
    byId("legend").replaceChildren(this.colouring.legend());
    this.viewer.setColours(this.colouring.colours(this.player.time));
  }

  showGhosts() {
    if (!byId("ghosts").checked) this.viewer.setGhosts();
    else this.viewer.setGhosts(Float32Array.from(this.info.boxes.target), upright(this.frames.n));
  }

  choose(box) {
    this.rows[this.chosen]?.removeAttribute("aria-current");
    this.rows[box]?.setAttribute("aria-current", "true");
    this.chosen = box;
    byId("box").value = box;
    const marks = [];
    const css = getComputedStyle(document.documentElement);
    if (box >= 0) marks.push({ box, colour: rgbOf(this.night.matches ? CHOSEN.dark : CHOSEN.light) });
    if (this.info.first) marks.unshift({ box: this.info.first.box, colour: rgbOf(css.getPropertyValue("--first").trim()) });
    this.viewer.setMarks(marks);
    showNumbers(byId("numbers"), box, this.info, this.frames, this.player.time);
  }

  placeLabels() {
    const { first, boxes } = this.info;
    const name = (box) => labelOf(box, boxes.article[box]);
    if (first) this.placeLabel(byId("label-first"), first.box, `first to fail: ${name(first.box)}`);
    const other = first && first.box === this.chosen ? -1 : this.chosen;
    this.placeLabel(byId("label-chosen"), other, other < 0 ? "" : name(other));
  }

  // Above the box, or beside the box without room above; always within the canvas.
  placeLabel(label, box, text) {
    const hull = box >= 0 ? this.viewer.hull(box) : null;
    label.hidden = !hull;
    if (!hull) return;
    label.textContent = text;
    const { offsetWidth: width, offsetHeight: height, parentElement: room } = label;
    let [x, y] = [(hull.left + hull.right - width) / 2, hull.top - height - LABEL_GAP];
    if (y < 0) {
      const right = hull.right + LABEL_GAP;
      x = right + width < room.clientWidth ? right : hull.left - width - LABEL_GAP;
      y = (Math.max(hull.top, 0) + hull.bottom - height) / 2;
    }
    x = clamped(x, 4, room.clientWidth - width - 4);
    y = clamped(y, 4, room.clientHeight - height - 4);
    label.style.transform = `translate(${x}px, ${y}px)`;
  }
}

async function main() {
  const info = readInfo();
  const { boxes, carrier, floorZ } = info;
  const viewer = createViewer(byId("canvas"), { sizes: boxes.size, carrier, floorZ });
  if (!viewer) {
    byId("why-still").textContent = "As it ended. This browser has no WebGL 2, so the pallet cannot be played and turned.";
    return;
  }
  const frames = new Frames(await readBlock("frames"));
  byId("still").hidden = true;
  for (const id of ["view", "player", "side", "help"]) byId(id).hidden = false;
  byId("all").open = false;
  new StoryPage(info, frames, viewer);
}

main();
