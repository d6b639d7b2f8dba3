// The clock of a story: a time that plays at a speed, jumps and steps.

import { clamped } from "./vectors.js";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

export class Player {
  // onTime(time) and onPlaying(whether) are called after every change.
  constructor(frames, onTime, onPlaying) {
    Object.assign(this, { frames, onTime, onPlaying, time: frames.end, speed: 1, playing: false });
  }

  go(time) {
    this.time = clamped(time, this.frames.start, this.frames.end);
    this.onTime(this.time);
  }

  seek(time) {
    this.pause();
    this.go(time);
  }

  step(frames) {
    const { time, count } = this.frames;
    const here = this.frames.at(this.time);
    // if the time is between two frames, a step back leads to the earlier frame
    const behind = frames < 0 && this.time > time[here] + 1e-6 ? 1 : 0;
    this.seek(time[clamped(here + frames + behind, 0, count - 1)]);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.time >= this.frames.end) this.go(this.frames.start);
    this.playing = true;
    this.onPlaying(true);
    let before = null;
    const tick = (now) => {
      if (!this.playing) return;
      // a tab that was hidden continues where it stopped
      const passed = before === null ? 0 : Math.min((now - before) / 1000, 0.25);
      before = now;
      this.go(this.time + passed * this.speed);
      if (this.time >= this.frames.end) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.onPlaying(false);
  }
}
