// The frames of a story, and the state of the pallet at any time between two of them.

import { slerp } from "./vectors.js";

export class Frames {
  // arrays: time, pos, quat, carrier_pos and carrier_quat; the other arrays of petmjx/show/pages/story_data.py if used
  constructor(arrays) {
    Object.assign(this, arrays);
    if (arrays.force_root) this.force_n = arrays.force_root.map((root) => root * Math.abs(root));
    this.count = arrays.time.length;
    this.n = arrays.pos.shape[1];
    this.start = arrays.time[0];
    this.end = arrays.time[this.count - 1];
  }

  // The last frame that is not after a time.
  at(time) {
    let [low, high] = [0, this.count - 1];
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (this.time[middle] <= time + 1e-9) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  // Moves the boxes and the carrier of a view to their poses at a time. Between two frames, places are on a straight
  // line, and orientations on the shortest arc. A box appears in the frame in which it is placed, not before.
  showIn(viewer, time) {
    const { pos, quat, carrier_pos: carrierPos, carrier_quat: carrierQuat } = this;
    const { frame, next, share } = this.between(time);
    viewer.setPoses(this.mixed(pos, 3 * this.n, frame, next, share), this.turns(quat, this.n, frame, next, share));
    const place = this.mixed(carrierPos, 3, frame, next, share);
    viewer.setCarrier([...place], [...this.turns(carrierQuat, 1, frame, next, share)]);
  }

  // One number per box, at the last frame: "shift_mm", "tilt_deg" or "force_n".
  values(name, time) {
    const frame = this.at(time);
    return this[name].subarray(frame * this.n, (frame + 1) * this.n);
  }

  between(time) {
    const frame = this.at(time);
    const next = Math.min(frame + 1, this.count - 1);
    const span = this.time[next] - this.time[frame];
    return { frame, next, share: span > 0 ? Math.min((time - this.time[frame]) / span, 1) : 0 };
  }

  mixed(values, size, frame, next, share) {
    const out = new Float32Array(size);
    const [from, to] = [frame * size, next * size];
    for (let k = 0; k < size; k++) {
      const before = values[from + k];
      const after = values[to + k];
      out[k] = Number.isNaN(after) ? before : before + share * (after - before);
    }
    return out;
  }

  turns(values, count, frame, next, share) {
    const out = new Float32Array(4 * count);
    const before = values.subarray(4 * count * frame, 4 * count * (frame + 1));
    const after = values.subarray(4 * count * next, 4 * count * (next + 1));
    for (let k = 0; k < count; k++) slerp(out, before, after, k, share);
    return out;
  }
}
