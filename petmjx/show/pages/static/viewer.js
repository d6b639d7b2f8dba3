// A view of boxes on a carrier in WebGL 2, without third-party code. Stories and reports use this view.
//
//   const viewer = createViewer(canvas, {sizes, carrier, floorZ});   null without WebGL 2
//
// Lengths are metres, z is up, quaternions (w, x, y, z), colours sRGB from 0 to 1, angles radians. Arrays are flat:
// `sizes` has 3 numbers per box, the whole extents. `carrier` is as in carrier.js; `floorZ` its floor.
//
//   setPoses(pos, quat)                 3 and 4 numbers per box; a box whose pos is NaN is not drawn
//   setCarrier(pos, quat)               the pose of the carrier, if it differs from the scene
//   setColours(rgb)                     3 numbers per box
//   setOpacity(share)                   1 (at first): opaque boxes; less: transparent boxes, so that arrows inside show
//   setGhosts(pos, quat)                transparent copies (ghosts) of the boxes at other poses. Ghosts are 2 mm
//                                       smaller, so that a box at the pose of its ghost hides it; () removes ghosts
//   setArrows(list)                     [{from: [x, y, z], vector: [x, y, z], colour: [r, g, b], radius}, …]
//   setMarks(list)                      [{box, colour: [r, g, b]}, …]: thick edges, visible even behind other boxes
//   frame(low, high, {azimuth, elevation})  shows all of the box from low to high; azimuth 0 looks along +y, and grows
//                                       towards +x; elevation is above the horizon. Without angles: as before
//   turn(right, up), zoom(factor), pan(right, up), reset()   move the camera, as mouse and fingers do. turn: radians;
//                                       pan: shares of the picture's height
//   pick(x, y)                          the box at a point of the canvas in CSS pixels, from 0, or −1
//   project([x, y, z])                  place of a point on the canvas, {x, y} in CSS pixels, or null behind the eye
//   hull(box)                           the frame around a box on the canvas, {left, top, right, bottom}, or null
//   onClick = (box) => …                called on a click; box −1: no box
//   onDraw = () => …                    after each drawing: for labels that lie above the canvas
//   redraw()                            requests a drawing; the functions that change the picture do it, too. There is
//                                       at most one drawing per frame of the browser
//   dispose()                           stops and frees the graphics card
//
// Colours of floor and edges follow the browser's light or dark mode; the page shines through as background. A lost
// context is restored by itself.

import { Camera } from "./camera.js";
import { boardsAt, corners } from "./carrier.js";
import { listen } from "./gestures.js";
import { LOOK } from "./appearance.js";
import { ARROW_NUMBERS, BOX_NUMBERS, Painter } from "./painter.js";
import { add, cornersBetween, dot, norm, scaled, sub, turned, turnedBack } from "./vectors.js";

const BOX_STRIDE = BOX_NUMBERS.reduce((a, b) => a + b);
const ARROW_STRIDE = ARROW_NUMBERS.reduce((a, b) => a + b);
const CARDBOARD = [0.8, 0.66, 0.47];
const EDGE = { width: 1.1, light: [0.12, 0.1, 0.08], dark: [0.05, 0.05, 0.06] };
const MARK_WIDTH = 3.5;
const GHOST = { opacity: 0.1, light: [0.1, 0.12, 0.16], dark: [0.86, 0.88, 0.92] };
const GHOST_GAP = 0.002;
const MOST_PIXELS = 2; // largest number of screen pixels per CSS pixel; more would cost time and not be visible

export function createViewer(canvas, scene) {
  const gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true });
  return gl ? new Viewer(canvas, gl, scene) : null;
}

class Viewer {
  constructor(canvas, gl, { sizes, carrier, floorZ }) {
    Object.assign(this, { canvas, gl, carrier, floorZ, camera: new Camera(), onClick: () => {}, onDraw: () => {} });
    this.painter = new Painter(gl);
    this.night = matchMedia("(prefers-color-scheme: dark)");
    this.stop = new AbortController();
    const signal = this.stop.signal;
    this.night.addEventListener("change", () => this.redraw(), { signal });
    canvas.addEventListener("webglcontextlost", (event) => this.lose(event), { signal });
    canvas.addEventListener("webglcontextrestored", () => this.recover(), { signal });
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(canvas);
    this.deafen = listen(canvas, {
      turn: (right, up) => this.turn(right, up),
      pan: (right, up) => this.pan(right, up),
      zoom: (factor) => this.zoom(factor),
      click: (x, y) => this.clicked(x, y),
    });
    const n = sizes.length / 3;
    this.n = n;
    this.half = Float32Array.from(sizes, (size) => size / 2);
    this.boards = boardsAt(carrier, carrier.pos, [1, 0, 0, 0]);
    this.pos = new Float32Array(3 * n).fill(NaN);
    this.quat = new Float32Array(4 * n);
    this.colours = new Float32Array(3 * n).map((_, k) => CARDBOARD[k % 3]);
    this.opacity = 1;
    this.ghosts = null;
    this.arrows = [];
    this.marks = [];
    this.values = new Float32Array((n + this.boards.length) * BOX_STRIDE);
    this.glass = new Float32Array((2 * n + this.boards.length) * BOX_STRIDE);
    const [low, high] = corners(carrier);
    this.frame(low, [high[0], high[1], 1]);
    this.resize();
  }

  setPoses(pos, quat) {
    this.pos = pos;
    this.quat = quat;
    this.redraw();
  }

  setCarrier(pos, quat) {
    this.boards = boardsAt(this.carrier, pos, quat);
    this.redraw();
  }

  setColours(rgb) {
    this.colours = rgb;
    this.redraw();
  }

  setOpacity(share) {
    this.opacity = share;
    this.redraw();
  }

  setGhosts(pos = null, quat = null) {
    this.ghosts = pos && { pos, quat };
    this.redraw();
  }

  setArrows(list) {
    this.arrows = list;
    this.redraw();
  }

  setMarks(list) {
    this.marks = list;
    this.redraw();
  }

  frame(low, high, { azimuth, elevation } = {}) {
    this.camera.frame(low, high, azimuth, elevation);
    const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
    this.bounds = { middle, reach: Math.max(norm(sub(high, low)) / 2, 0.5) * 1.15 };
    this.redraw();
  }

  turn(right, up) {
    this.camera.turn(right, up);
    this.redraw();
  }

  zoom(factor) {
    this.camera.zoom(factor);
    this.redraw();
  }

  pan(right, up) {
    this.camera.pan(right, up);
    this.redraw();
  }

  reset() {
    this.camera.reset();
    this.redraw();
  }

  pick(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { from, along } = this.camera.ray((2 * x) / width - 1, 1 - (2 * y) / height);
    const boards = this.boards.filter(({ isWall }) => !isWall);
    let nearest = Math.min(...boards.map((board) => this.distanceTo(board, from, along)));
    let picked = -1;
    for (let box = 0; box < this.n; box++) {
      const distance = this.distanceTo(this.box(box), from, along);
      if (distance < nearest) [nearest, picked] = [distance, box];
    }
    return picked;
  }

  project(point) {
    const seen = this.camera.project(point);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return seen && { x: ((seen[0] + 1) / 2) * width, y: ((1 - seen[1]) / 2) * height };
  }

  hull(box) {
    const { pos, quat, half } = this.box(box);
    if (Number.isNaN(pos[0])) return null;
    const seen = cornersBetween(scaled(half, -1), half).map((corner) => this.project(add(turned(quat, corner), pos)));
    if (seen.includes(null)) return null;
    const [x, y] = [seen.map((point) => point.x), seen.map((point) => point.y)];
    return { left: Math.min(...x), right: Math.max(...x), top: Math.min(...y), bottom: Math.max(...y) };
  }

  redraw() {
    if (this.asked || this.stop.signal.aborted) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = 0;
      if (this.painter) this.draw();
    });
  }

  dispose() {
    this.stop.abort();
    this.sizes.disconnect();
    this.deafen();
    cancelAnimationFrame(this.asked);
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  // ---- private

  box(k) {
    const slice = (values, size) => values.subarray(size * k, size * (k + 1));
    return { pos: slice(this.pos, 3), quat: slice(this.quat, 4), half: slice(this.half, 3) };
  }

  // Distance along a line of sight at which a box begins; Infinity if the line misses the box, or if the box has no
  // place yet.
  distanceTo({ pos, quat, half }, from, along) {
    if (Number.isNaN(pos[0])) return Infinity;
    const start = turnedBack(quat, sub(from, pos));
    const way = turnedBack(quat, along);
    let [enter, leave] = [0, Infinity];
    for (let axis = 0; axis < 3; axis++) {
      const ends = [-half[axis], half[axis]].map((side) => (side - start[axis]) / way[axis]);
      enter = Math.max(enter, Math.min(...ends));
      leave = Math.min(leave, Math.max(...ends));
    }
    return enter <= leave ? enter : Infinity;
  }

  clicked(pageX, pageY) {
    const frame = this.canvas.getBoundingClientRect();
    this.onClick(this.pick(pageX - frame.left, pageY - frame.top));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const density = Math.min(devicePixelRatio || 1, MOST_PIXELS);
    this.density = density;
    this.canvas.width = Math.max(1, Math.round(width * density));
    this.canvas.height = Math.max(1, Math.round(height * density));
    this.camera.resized(this.canvas.width / this.canvas.height);
    this.redraw();
  }

  lose(event) {
    event.preventDefault(); // else the context is never restored
    this.painter = null;
  }

  recover() {
    this.painter = new Painter(this.gl);
    this.redraw();
  }

  draw() {
    const edge = this.edge();
    const solid = { values: this.values, count: 0 };
    const glass = { values: this.glass, count: 0 };
    const into = this.opacity < 1 ? glass : solid;
    for (const box of this.farthestFirst()) this.write(into, this.box(box), this.colourOf(box), this.edgeOf(box, edge));
    for (const board of this.boards) {
      const [list, opacity] = board.isWall ? [glass, LOOK.wall] : [solid, 1];
      this.write(list, board, [...LOOK.wood, opacity], edge);
    }
    const marked = { values: new Float32Array(this.marks.length * BOX_STRIDE), count: 0 };
    for (const { box, colour } of this.marks) {
      const line = [...colour, MARK_WIDTH * this.density];
      if (!Number.isNaN(this.pos[3 * box])) this.write(marked, this.box(box), [...colour, 0], line);
    }
    this.writeGhosts(glass);
    const { camera, bounds, floorZ } = this;
    const dark = this.night.matches;
    this.painter.draw({ camera, dark, ...bounds, floorZ, solid, glass, marked, arrows: this.arrowValues() });
    this.onDraw();
  }

  colourOf(box) {
    return [...this.colours.subarray(3 * box, 3 * box + 3), this.opacity];
  }

  edge() {
    return [...(this.night.matches ? EDGE.dark : EDGE.light), EDGE.width * this.density];
  }

  edgeOf(box, edge) {
    const mark = this.marks.find((each) => each.box === box);
    return mark ? [...mark.colour, MARK_WIDTH * this.density] : edge;
  }

  // Numbers of the placed boxes, from the farthest to the nearest: transparent boxes must be drawn in this order.
  farthestFirst() {
    const placed = [...Array(this.n).keys()].filter((box) => !Number.isNaN(this.pos[3 * box]));
    if (this.opacity >= 1) return placed;
    const { forward } = this.camera.axes();
    const depth = placed.map((box) => dot(forward, this.pos.subarray(3 * box, 3 * box + 3)));
    return placed.map((_, k) => k).sort((a, b) => depth[b] - depth[a]).map((k) => placed[k]);
  }

  writeGhosts(glass) {
    if (!this.ghosts) return;
    const tint = this.night.matches ? GHOST.dark : GHOST.light;
    const edge = [...tint, EDGE.width * this.density];
    for (let k = 0; k < this.n; k++) {
      const pos = this.ghosts.pos.subarray(3 * k, 3 * k + 3);
      const quat = this.ghosts.quat.subarray(4 * k, 4 * k + 4);
      const half = this.half.subarray(3 * k, 3 * k + 3).map((size) => size - GHOST_GAP);
      this.write(glass, { pos, quat, half }, [...tint, GHOST.opacity], edge);
    }
  }

  write(list, { pos, quat, half }, colour, edge) {
    const at = list.count * BOX_STRIDE;
    list.values.set(pos, at);
    list.values.set(quat, at + 3);
    list.values.set(half, at + 7);
    list.values.set(colour, at + 10);
    list.values.set(edge, at + 14);
    list.count += 1;
  }

  arrowValues() {
    const values = new Float32Array(this.arrows.length * ARROW_STRIDE);
    this.arrows.forEach(({ from, vector, colour, radius }, k) => {
      values.set([...from, ...vector, ...colour, radius], k * ARROW_STRIDE);
    });
    return { values, count: this.arrows.length };
  }
}
