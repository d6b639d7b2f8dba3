// Vectors, quaternions (w, x, y, z) and 4 × 4 matrices (by columns, as WebGL takes them). All are arrays of numbers.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scaled = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const unit = (a) => scaled(a, 1 / (norm(a) || 1));
export const clamped = (value, low, high) => Math.min(Math.max(value, low), high);

// A vector turned by a unit quaternion, and turned back.
export function turned(q, v) {
  const axis = [q[1], q[2], q[3]];
  const twice = scaled(cross(axis, v), 2);
  return add(add(v, scaled(twice, q[0])), cross(axis, twice));
}
export const turnedBack = (q, v) => turned([q[0], -q[1], -q[2], -q[3]], v);

// Quaternions of `count` bodies that are not turned, one after another.
export const upright = (count) => Float32Array.from({ length: 4 * count }, (_, k) => (k % 4 === 0 ? 1 : 0));

// The eight corners of the box from one corner to the opposite one.
export const cornersBetween = (low, high) =>
  [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [0, 1, 2].map((axis) => (k & (1 << axis) ? high : low)[axis]));

// Writes to out[4 k …] the quaternion a share `t` of the way from a[4 k …] to b[4 k …], on the shorter arc.
export function slerp(out, a, b, k, t) {
  const i = 4 * k;
  let cosine = a[i] * b[i] + a[i + 1] * b[i + 1] + a[i + 2] * b[i + 2] + a[i + 3] * b[i + 3];
  const sign = cosine < 0 ? -1 : 1;
  cosine = Math.min(cosine * sign, 1);
  const angle = Math.acos(cosine);
  // for nearly equal quaternions rounding spoils the sines, and a straight line is as good
  const near = angle < 1e-3;
  const from = near ? 1 - t : Math.sin((1 - t) * angle) / Math.sin(angle);
  const to = sign * (near ? t : Math.sin(t * angle) / Math.sin(angle));
  let square = 0;
  for (let c = 0; c < 4; c++) {
    out[i + c] = from * a[i + c] + to * b[i + c];
    square += out[i + c] * out[i + c];
  }
  const length = Math.sqrt(square) || 1;
  for (let c = 0; c < 4; c++) out[i + c] /= length;
}

export function product(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
      out[4 * column + row] = sum;
    }
  }
  return out;
}

// A matrix times a point, in homogeneous coordinates: [x, y, z, w], not yet divided by w.
export function transformed(matrix, point) {
  const out = [0, 0, 0, 0];
  for (let row = 0; row < 4; row++) {
    out[row] = matrix[row] * point[0] + matrix[4 + row] * point[1] + matrix[8 + row] * point[2] + matrix[12 + row];
  }
  return out;
}

// The matrix from world coordinates to those of the eye: x points to the right, y up, and the eye looks along −z.
export function looking(eye, target, up) {
  const back = unit(sub(eye, target));
  const right = unit(cross(up, back));
  const top = cross(back, right);
  return new Float32Array([
    right[0], top[0], back[0], 0,
    right[1], top[1], back[1], 0,
    right[2], top[2], back[2], 0,
    -dot(right, eye), -dot(top, eye), -dot(back, eye), 1,
  ]);
}

// The matrix of a perspective projection. `slope` is the tangent of half the vertical angle of view.
export function perspective(slope, aspect, near, far) {
  const depth = 1 / (near - far);
  return new Float32Array([
    1 / (slope * aspect), 0, 0, 0,
    0, 1 / slope, 0, 0,
    0, 0, (near + far) * depth, -1,
    0, 0, 2 * near * far * depth, 0,
  ]);
}

// The matrix of a parallel projection. `reach` is half the width and half the height of the region that it shows.
export function orthographic(reach, near, far) {
  const depth = 1 / (near - far);
  return new Float32Array([
    1 / reach, 0, 0, 0,
    0, 1 / reach, 0, 0,
    0, 0, 2 * depth, 0,
    0, 0, (near + far) * depth, 1,
  ]);
}
