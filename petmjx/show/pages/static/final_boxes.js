// The final boxes of one world, from the blocks that petmjx/show/report/world_blocks.py packs.

import { readBlock } from "./page_data.js";
import { corners } from "./carrier.js";

const PER_M = 1e4; // planned places are tenths of a millimetre
const MM = 1000;
const KEPT = 6; // largest number of blocks whose unpacked arrays are kept
const unpacked = new Map();

// The boxes of world `number`. Lengths are in m, except `moved` (largest component of the shift) and `sides`, which are
// in mm. Poses of boxes that were not placed are NaN.
export async function endedWorld(number, worldsPerBlock) {
  const arrays = await blockOf(Math.floor(number / worldsPerBlock));
  const at = number % worldsPerBlock;
  const first = arrays.count.subarray(0, at).reduce((sum, count) => sum + count, 0);
  const n = arrays.count[at];
  const part = (name, size) => arrays[name].subarray(size * first, size * (first + n));
  const board = arrays.n_boards.subarray(0, at).reduce((sum, count) => sum + count, 0);
  const boards = [...arrays.boards.subarray(6 * board, 6 * (board + arrays.n_boards[at]))];
  const kinds = Array.from(part("kind", 1), (kind) => arrays.items[kind]);
  const planned = Float32Array.from(part("planned", 3), (tenths) => tenths / PER_M);
  const moved = part("moved", 3);
  return {
    n,
    item: kinds.map((kind) => kind[0]),
    article: kinds.map((kind) => kind[1]),
    sides: kinds.map((kind) => kind.slice(2, 5)),
    mass: kinds.map((kind) => kind[5]),
    sizes: Float32Array.from(kinds.flatMap((kind) => kind.slice(2, 5)), (side) => side / MM),
    planned,
    pos: planned.map((place, k) => place + moved[k]),
    quat: quaternions(part("turn", 3)),
    moved: Float32Array.from({ length: n }, (_, box) => MM * largest(moved.subarray(3 * box, 3 * box + 3))),
    tilt: part("tilt", 1),
    force: part("force", 1).map(Math.expm1),
    rest: part("rest", 1).map(Math.expm1),
    drop: part("drop", 1),
    carrier: { pos: [...arrays.carrier.subarray(3 * at, 3 * at + 3)], boards, walls: arrays.n_walls[at] },
  };
}

function blockOf(number) {
  if (!unpacked.has(number)) {
    const ready = readBlock(`boxes-${number}`).then((arrays) => {
      return { ...arrays, items: JSON.parse(new TextDecoder().decode(arrays.items)) };
    });
    unpacked.set(number, ready);
    if (unpacked.size > KEPT) unpacked.delete(unpacked.keys().next().value);
  }
  return unpacked.get(number);
}

// The real part follows from the length 1. The sign of the quaternion is chosen so that w is never negative.
function quaternions(turn) {
  const found = new Float32Array((turn.length / 3) * 4);
  for (let box = 0; box < turn.length / 3; box++) {
    const [x, y, z] = turn.subarray(3 * box, 3 * box + 3);
    found.set([Math.sqrt(Math.max(0, 1 - x * x - y * y - z * z)), x, y, z], 4 * box);
  }
  return found;
}

function largest(values) {
  return Math.max(...Array.from(values, Math.abs));
}

const FAR = 0.8; // m; the view need not show boxes that are farther from the pallet

// The region that the view shows: the carrier, the planned boxes, and the boxes that are near the pallet at the end.
export function bounds({ n, sizes, planned, pos, carrier }) {
  const [low, high] = corners(carrier);
  const widen = (places, lowest, highest) => {
    for (let k = 0; k < 3 * n; k++) {
      if (Number.isNaN(places[k])) continue;
      const axis = k % 3;
      low[axis] = Math.min(low[axis], Math.max(lowest[axis], places[k] - sizes[k] / 2));
      high[axis] = Math.max(high[axis], Math.min(highest[axis], places[k] + sizes[k] / 2));
    }
  };
  widen(planned, [-Infinity, -Infinity, -Infinity], [Infinity, Infinity, Infinity]);
  const near = [low.map((end, k) => (k < 2 ? end - FAR : end)), high.map((end, k) => (k < 2 ? end + FAR : end + 0.2))];
  widen(pos, ...near);
  return [low, high];
}
