// Plays the recorded history of a world, with controls below its picture: a button, a time line, the time.

import { readBlock } from "./page_data.js";
import { make } from "./dom.js";
import { Frames } from "./frames.js";
import { Player, SPEEDS } from "./player.js";

const PARTS = 1000; // number of positions of the slider

export class Replay {
  // number: N of the block "replay-N"
  constructor(number, viewer) {
    Object.assign(this, { number, viewer, player: null });
    this.button = make("button", { type: "button", class: "main" }, "Play");
    this.slider = make("input", { type: "range", min: 0, max: PARTS, value: PARTS, "aria-label": "Time" });
    const speeds = SPEEDS.map((speed) => make("option", { value: speed }, `${speed}×`));
    this.speed = make("select", { "aria-label": "Speed" }, ...speeds);
    this.speed.value = 1;
    this.now = make("span", { class: "small faint" });
    this.element = make("div", { class: "line replay" }, this.button, this.slider, this.speed, this.now);
    const on = (element, name, act) => element.addEventListener(name, () => this.ready().then(act));
    on(this.button, "click", (player) => player.toggle());
    on(this.slider, "input", (player) => player.seek(this.asked()));
    on(this.speed, "change", (player) => (player.speed = Number(this.speed.value)));
  }

  dispose() {
    this.player?.pause();
  }

  // ---- private

  // A history is unpacked when it is first played, since most histories of a report are never played.
  async ready() {
    this.frames ??= readBlock(`replay-${this.number}`).then((arrays) => new Frames(arrays));
    const frames = await this.frames;
    this.player ??= new Player(frames, (time) => this.show(frames, time), (playing) => {
      this.button.textContent = playing ? "Pause" : "Play";
    });
    return this.player;
  }

  asked() {
    const { start, end } = this.player.frames;
    return start + (Number(this.slider.value) / PARTS) * (end - start);
  }

  show(frames, time) {
    frames.showIn(this.viewer, time);
    this.slider.value = (PARTS * (time - frames.start)) / (frames.end - frames.start || 1);
    const placed = frames.placed[frames.at(time)];
    this.now.textContent = `${time.toFixed(2)} of ${frames.end.toFixed(2)} s, ${placed} placed`;
  }
}
