// Draws one picture of boxes, arrows and the floor with WebGL 2. All its state is on the graphics card,
// so that a new painter can replace one whose context was lost.

import { Instances, depthMap, program } from "./gl.js";
import { LOOK } from "./appearance.js";
import { arrow, cube, square } from "./meshes.js";
import * as shaders from "./shaders.js";
import { add, looking, orthographic, product, scaled, unit } from "./vectors.js";

export const BOX_NUMBERS = [3, 4, 3, 4, 4]; // centre, quaternion, half size, colour, edge (colour and pixels)
export const ARROW_NUMBERS = [3, 3, 4]; // start, vector, colour and radius

const SUNWARD = unit(LOOK.sunward);

export class Painter {
  constructor(gl) {
    this.gl = gl;
    this.boxes = program(gl, shaders.BOX_VERTEX, shaders.BOX_FRAGMENT);
    this.depths = program(gl, shaders.BOX_VERTEX, shaders.DEPTH_FRAGMENT);
    this.arrows = program(gl, shaders.ARROW_VERTEX, shaders.ARROW_FRAGMENT);
    this.floor = program(gl, shaders.FLOOR_VERTEX, shaders.FLOOR_FRAGMENT);
    this.map = depthMap(gl, LOOK.shadowPixels);
    const boxes = () => new Instances(gl, cube(), [3, 3], BOX_NUMBERS);
    this.meshes = {
      solid: boxes(),
      glass: boxes(),
      marked: boxes(),
      arrows: new Instances(gl, arrow(), [4, 3], ARROW_NUMBERS),
      floor: new Instances(gl, square(), [2], []),
    };
    this.meshes.floor.count = 1;
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // picture: {camera, dark, middle, reach, floorZ, solid, glass, marked, arrows}; the last four are {values, count}.
  // `glass` has the transparent boxes; they are drawn in their order, so the farthest box comes first. The edges of
  // the boxes `marked` are also seen through other boxes.
  draw(picture) {
    const { gl, meshes } = this;
    for (const name of ["solid", "glass", "marked", "arrows"]) {
      meshes[name].fill(picture[name].values, picture[name].count);
    }
    const sun = this.sunMatrix(picture);
    this.drawDepths(sun);
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.bindTexture(gl.TEXTURE_2D, this.map.texture);
    const common = { clip: picture.camera.matrix(), sun, sunward: SUNWARD, eye: picture.camera.eye() };
    this.boxes.set({ ...common, lines: 1, lit: true });
    meshes.solid.draw();
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    this.drawFloor(picture, common);
    this.boxes.set({ lines: 0.75, lit: true });
    meshes.glass.draw();
    gl.depthFunc(gl.GREATER);
    this.boxes.set({ lines: 0.45, lit: false });
    meshes.marked.draw();
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    this.arrows.set({ clip: common.clip, eye: common.eye }); // after transparent boxes, which would dull them
    meshes.arrows.draw();
  }

  sunMatrix({ middle, reach }) {
    const eye = add(middle, scaled(SUNWARD, 2 * reach));
    return product(orthographic(reach, 0.1, 4 * reach), looking(eye, middle, [0, 0, 1]));
  }

  drawDepths(sun) {
    const { gl, map } = this;
    gl.bindTexture(gl.TEXTURE_2D, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, map.frame);
    gl.viewport(0, 0, map.size, map.size);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.depths.set({ clip: sun });
    this.meshes.solid.draw();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  drawFloor({ camera, dark, middle, reach, floorZ }, { clip, sun }) {
    const { ground, ruled, shade } = dark ? LOOK.themes.dark : LOOK.themes.light;
    if (camera.eye()[2] < floorZ) return; // seen from below, the floor would hide the boxes on it
    this.floor.set({ clip, sun, middle: [middle[0], middle[1], floorZ], reach: 2.2 * reach, ground, ruled, shade });
    this.meshes.floor.draw();
  }
}
