// The three shapes that are drawn, as vertices of triangles.

// A cube from −1 to 1: place and normal, 6 numbers per vertex.
export function cube() {
  const out = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const side of [-1, 1]) {
      const corner = (u, v) => {
        const place = [0, 0, 0];
        place[axis] = side;
        place[(axis + 1) % 3] = u;
        place[(axis + 2) % 3] = v;
        return place;
      };
      const normal = [0, 0, 0];
      normal[axis] = side;
      // counter-clockwise, seen from outside
      const square = [corner(-1, -1), corner(side, -side), corner(1, 1), corner(-side, side)];
      for (const k of [0, 1, 2, 0, 2, 3]) out.push(...square[k], ...normal);
    }
  }
  return new Float32Array(out);
}

// An arrow along z: x, y, z, part (0 shaft, 1 head) and the normal, 7 numbers per vertex. Shaft and head are 1 long
// and have radius 1; the shader stretches both.
export function arrow(sides = 14) {
  const out = [];
  const ring = (k) => [Math.cos((2 * Math.PI * k) / sides), Math.sin((2 * Math.PI * k) / sides)];
  for (let k = 0; k < sides; k++) {
    const [ax, ay] = ring(k);
    const [bx, by] = ring(k + 1);
    const shaft = [[ax, ay, 0], [bx, by, 0], [bx, by, 1], [ax, ay, 1]];
    const normals = [[ax, ay, 0], [bx, by, 0], [bx, by, 0], [ax, ay, 0]];
    for (const c of [0, 1, 2, 0, 2, 3]) out.push(...shaft[c], 0, ...normals[c]);
    const slope = 0.5;
    out.push(ax, ay, 0, 1, ax, ay, slope, bx, by, 0, 1, bx, by, slope, 0, 0, 1, 1, (ax + bx) / 2, (ay + by) / 2, slope);
    out.push(bx, by, 0, 1, 0, 0, -1, ax, ay, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1);
  }
  return new Float32Array(out);
}

export const square = () => new Float32Array([-1, -1, 1, -1, 1, 1, -1, -1, 1, 1, -1, 1]);
