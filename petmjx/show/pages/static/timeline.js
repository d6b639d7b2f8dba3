// The time line: a slider with marks above it, and below it a curve of the shaking.

import { byId, make, makeSvg } from "./dom.js";

const WIDTH = 1000;

export class Timeline {
  // onSeek(time) is called when the slider is dragged. `level(frame)` in g, or null without a drive.
  constructor(info, frames, level, onSeek) {
    this.frames = frames;
    this.slider = byId("time");
    Object.assign(this.slider, { min: frames.start, max: frames.end });
    this.slider.addEventListener("input", () => onSeek(Number(this.slider.value)));
    this.addMarks(info);
    if (level) this.addCurve(level);
  }

  x(time) {
    const span = this.frames.end - this.frames.start || 1;
    return ((time - this.frames.start) / span) * WIDTH;
  }

  addMarks({ boxes, first }) {
    const key = byId("key");
    const times = (values) => values.filter((time) => time !== null);
    const placed = times(boxes.placed_s);
    const drops = times(boxes.drop_s);
    const signs = first && first.time !== null ? [first.time] : [];
    for (const [name, moments, top, words] of [
      ["placed", placed, 13, "a box is placed"],
      ["drop", drops, 6, "a box has dropped"],
      ["sign", signs, 0, "first sign"],
    ]) {
      for (const time of moments) {
        const x = this.x(time);
        byId("marks").append(makeSvg("line", { class: name, x1: x, x2: x, y1: top, y2: 20 }));
      }
      if (moments.length) key.append(make("span", {}, make("i", { class: name }), words));
    }
  }

  addCurve(level) {
    const { frames } = this;
    const levels = Array.from({ length: frames.count }, (_, frame) => level(frame));
    const most = Math.max(...levels);
    const y = (value) => 38 - (34 * value) / most;
    const points = levels.map((value, frame) => `${this.x(frames.time[frame]).toFixed(1)},${y(value).toFixed(1)}`);
    const curve = byId("curve");
    curve.append(makeSvg("line", { x1: 0, x2: WIDTH, y1: y(0), y2: y(0) }), makeSvg("path", { d: `M${points.join("L")}` }));
    const words = `level of shaking, up to ${most.toFixed(2)} g`;
    curve.setAttribute("aria-label", words);
    curve.setAttribute("role", "img");
    curve.removeAttribute("hidden");
    byId("key").append(make("span", {}, make("i", { class: "curve" }), words));
  }

  show(time, words) {
    this.slider.value = time;
    this.slider.setAttribute("aria-valuetext", words);
  }
}
