// Arrows of a story: contact forces, and the shaking of the pallet.

import { corners } from "./carrier.js";
import { roundedUp, shareOf } from "./colours.js";
import { norm, scaled, sub, unit } from "./vectors.js";

const LENGTH = 0.2; // m, length of the arrow that shows the force `scale_n`
const RADIUS = 0.008; // m
const LEAST = 0.03; // contacts with a force below this share of `scale_n` have no arrow
const G_LENGTH = 0.45; // m, length of the arrow that shows an acceleration of 1 g
const DRIVE_RADIUS = 0.014;
const ORANGE = [0.9, 0.35, 0.05];

const INK = { light: [0.08, 0.08, 0.1], dark: [0.97, 0.97, 0.99] };

const ink = () => (matchMedia("(prefers-color-scheme: dark)").matches ? INK.dark : INK.light);

// Contact forces in each frame: {scale_n: force in N that gets an arrow of `LENGTH`, at(frame): arrows}.
export function contactArrows({ frame, point, force }, frames) {
  const rows = Array.from({ length: frames.count }, () => []);
  frame.forEach((number, row) => rows[number].push(row));
  const vector = (values, row) => [values[3 * row], values[3 * row + 1], values[3 * row + 2]];
  const strength = Float32Array.from(frame, (_, row) => norm(vector(force, row)));
  const scale = roundedUp(shareOf(strength, 0.9));
  const arrow = (row) => {
    const along = scaled(vector(force, row), LENGTH / scale);
    // the tip is at the point where the force acts
    return { from: sub(vector(point, row), along), vector: along, colour: ink(), radius: RADIUS };
  };
  return {
    scale_n: scale,
    at: (number) => rows[number].filter((row) => strength[row] > LEAST * scale).map(arrow),
  };
}

// The shaking of a pallet: {level(frame): strength in g, at(frame): arrows, words(frame): the strength as a text}.
export function driveArrows(info, frames) {
  const { kind, one_g: oneG } = info.drive;
  const vector = (frame) => [0, 1, 2].map((axis) => frames.drive[3 * frame + axis] / oneG);
  const level = (frame) => norm(vector(frame));
  const [low, high] = corners(info.carrier);
  const reach = scaled(sub(high, low), 0.5);

  // seen from the carrier, gravity turns: g − a
  const felt = (frame) => sub([0, 0, -1], vector(frame));
  const beside = [low[0] - 0.3, low[1], 0.5];
  const gravity = (frame) => {
    const pull = scaled(felt(frame), G_LENGTH);
    return { from: beside, vector: pull, colour: ORANGE, radius: DRIVE_RADIUS };
  };

  const push = (frame) => {
    const along = unit(vector(frame));
    const carrier = [0, 1, 2].map((axis) => frames.carrier_pos[3 * frame + axis]);
    const toSide = Math.min(...along.map((part, axis) => reach[axis] / Math.max(Math.abs(part), 1e-9)));
    const length = G_LENGTH * level(frame);
    const from = sub(carrier, scaled(along, toSide + length));
    return { from, vector: scaled(along, length), colour: ORANGE, radius: DRIVE_RADIUS };
  };

  const words = (frame) => {
    const now = `${level(frame).toFixed(2)} g`;
    if (kind === "force") return `force on the carrier ${now} (of the weight of boxes and carrier)`;
    const [x, y, z] = felt(frame);
    const angle = (Math.atan2(Math.hypot(x, y), -z) * 180) / Math.PI;
    const gravity = `${norm(felt(frame)).toFixed(2)} g, ${angle.toFixed(0)}° from vertical`;
    return `acceleration ${now}; arrow: gravity as the load feels it, ${gravity}`;
  };
  const at = (frame) => (kind === "force" ? (level(frame) > 0 ? [push(frame)] : []) : [gravity(frame)]);
  return { level, at, words };
}
