// A camera that turns around a target. Angles in radians, lengths in metres, z is up.

import { LOOK } from "./appearance.js";
import { add, clamped, cornersBetween, cross, dot, looking } from "./vectors.js";
import { perspective, product, scaled, sub, transformed, unit } from "./vectors.js";

const SLOPE = Math.tan((32 * Math.PI) / 360); // tangent of half the vertical angle of view, which is 32°
const MARGIN = 1.06; // distance of the camera, as a multiple of the smallest one that shows the whole region
const STEEPEST = (88 * Math.PI) / 180; // radians; a camera straight above the target would have no direction "up"
const UP = [0, 0, 1];

export class Camera {
  constructor() {
    this.aspect = 1;
    this.frame([-1, -1, -1], [1, 1, 1], LOOK.view.azimuth, LOOK.view.elevation);
  }

  // Looks at the box with the corners `low` and `high`, from the nearest place from which the whole box is visible. A
  // corner c, measured from the box's middle, is in the picture if |c·side − target·side| ≤ slope (distance +
  // c·forward), for both sides of the picture.
  frame(low, high, azimuth = this.azimuth, elevation = this.elevation) {
    Object.assign(this, { low, high, azimuth, elevation, home: { azimuth, elevation }, moved: false });
    this.target = scaled(add(low, high), 0.5);
    this.distance = 0.1;
    const { right, top, forward } = this.axes();
    const from = cornersBetween(low, high).map((corner) => sub(corner, this.target));
    for (const [side, slope] of [[right, SLOPE * this.aspect], [top, SLOPE]]) {
      const one = Math.max(...from.map((c) => dot(c, side) - slope * dot(c, forward)));
      const other = Math.max(...from.map((c) => -dot(c, side) - slope * dot(c, forward)));
      this.distance = Math.max(this.distance, (MARGIN * (one + other)) / (2 * slope));
      this.target = add(this.target, scaled(side, (one - other) / 2));
    }
  }

  // Returns to the view of `frame`. `resized` does the same if the user has not moved the camera.
  reset() {
    this.frame(this.low, this.high, this.home.azimuth, this.home.elevation);
  }

  resized(aspect) {
    this.aspect = aspect;
    if (!this.moved) this.reset();
  }

  axes() {
    const flat = Math.cos(this.elevation);
    const back = [Math.sin(this.azimuth) * flat, -Math.cos(this.azimuth) * flat, Math.sin(this.elevation)];
    const right = unit(cross(UP, back));
    return { right, top: cross(back, right), forward: scaled(back, -1) };
  }

  eye() {
    return sub(this.target, scaled(this.axes().forward, this.distance));
  }

  matrix() {
    const near = this.distance * 0.02;
    const far = this.distance * 4 + 40;
    return product(perspective(SLOPE, this.aspect, near, far), looking(this.eye(), this.target, UP));
  }

  turn(right, up) {
    this.moved = true;
    this.azimuth -= right;
    this.elevation = clamped(this.elevation + up, -0.1, STEEPEST);
  }

  zoom(factor) {
    this.moved = true;
    this.distance = clamped(this.distance * factor, 0.2, 60);
  }

  // Moves the target, by shares of the picture's height.
  pan(right, up) {
    this.moved = true;
    const axes = this.axes();
    const height = 2 * SLOPE * this.distance;
    const step = add(scaled(axes.right, -right * height), scaled(axes.top, -up * height));
    this.target = add(this.target, step);
  }

  // The line of sight through a point of the picture, x and y from −1 to 1 (right, up).
  ray(x, y) {
    const { right, top, forward } = this.axes();
    const side = add(scaled(right, x * SLOPE * this.aspect), scaled(top, y * SLOPE));
    return { from: this.eye(), along: unit(add(forward, side)) };
  }

  // The place of a point in the picture, x and y from −1 to 1; null behind the camera.
  project(point) {
    const [x, y, , w] = transformed(this.matrix(), point);
    return w > 0 ? [x / w, y / w] : null;
  }

  // Metres that a pixel covers at the target, in a picture of this height.
  metresPerPixel(height) {
    return (2 * SLOPE * this.distance) / height;
  }
}
