// The carrier of boxes: {pos: [x, y, z], boards: …}, with 6 numbers a board, its whole extents and its place seen from
// `pos`. Lengths are metres.

import { add, turned } from "./vectors.js";

// The boards when the carrier is at a pose: [{pos, quat, half}, …].
export function boardsAt({ boards }, pos, quat) {
  return Array.from({ length: boards.length / 6 }, (_, k) => {
    const [size, place] = [boards.slice(6 * k, 6 * k + 3), boards.slice(6 * k + 3, 6 * k + 6)];
    return { pos: add(pos, turned(quat, place)), quat, half: Array.from(size, (each) => each / 2) };
  });
}

// The lowest and the highest corner of the boards at the carrier's own place.
export function corners(carrier) {
  const all = boardsAt(carrier, carrier.pos, [1, 0, 0, 0]);
  const end = (side, most) => [0, 1, 2].map((axis) => most(...all.map(({ pos, half }) => pos[axis] + side * half[axis])));
  return [end(-1, Math.min), end(1, Math.max)];
}
