// The carrier of boxes: {pos: [x, y, z], boards: …, walls}, with 6 numbers per board: its whole extents, and its place
// relative to `pos`. The last `walls` boards are walls, which are drawn transparent. Lengths are metres.

import { add, turned } from "./vectors.js";

// The boards when the carrier is at a pose: [{pos, quat, half, isWall}, …].
export function boardsAt({ boards, walls }, pos, quat) {
  return Array.from({ length: boards.length / 6 }, (_, k) => {
    const [size, place] = [boards.slice(6 * k, 6 * k + 3), boards.slice(6 * k + 3, 6 * k + 6)];
    const isWall = k >= boards.length / 6 - walls;
    return { pos: add(pos, turned(quat, place)), quat, half: Array.from(size, (each) => each / 2), isWall };
  });
}

// The lowest and the highest corner of the boards at the carrier's own place.
export function corners(carrier) {
  const all = boardsAt(carrier, carrier.pos, [1, 0, 0, 0]);
  const end = (side, most) => [0, 1, 2].map((axis) => most(...all.map(({ pos, half }) => pos[axis] + side * half[axis])));
  return [end(-1, Math.min), end(1, Math.max)];
}
