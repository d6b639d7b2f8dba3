// Small helpers around WebGL 2.

export function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const places = {};
  return {
    made,
    // Sets uniforms by name: numbers, vectors of 3, matrices of 16, booleans.
    set(values) {
      gl.useProgram(made);
      for (const [name, value] of Object.entries(values)) {
        if (!(name in places)) places[name] = gl.getUniformLocation(made, name);
        if (typeof value === "number") gl.uniform1f(places[name], value);
        else if (typeof value === "boolean") gl.uniform1i(places[name], value ? 1 : 0);
        else if (value.length === 3) gl.uniform3fv(places[name], value);
        else gl.uniformMatrix4fv(places[name], false, value);
      }
    },
  };
}

// Draws many instances of a mesh. `shape` has how many numbers each attribute of a vertex has, and `each` how many
// numbers each attribute of an instance has.
export class Instances {
  constructor(gl, mesh, shape, each) {
    this.gl = gl;
    this.vertices = mesh.length / sum(shape);
    this.stride = sum(each);
    this.array = gl.createVertexArray();
    this.room = 0;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, mesh, gl.STATIC_DRAW);
    this.declare(shape, 0, 0);
    this.buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    this.declare(each, shape.length, 1);
  }

  declare(sizes, first, divisor) {
    const { gl } = this;
    let at = 0;
    sizes.forEach((size, k) => {
      gl.enableVertexAttribArray(first + k);
      gl.vertexAttribPointer(first + k, size, gl.FLOAT, false, 4 * sum(sizes), 4 * at);
      gl.vertexAttribDivisor(first + k, divisor);
      at += size;
    });
  }

  // `values` holds `count` instances.
  fill(values, count) {
    const { gl } = this;
    this.count = count;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    if (values.length > this.room) {
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
      this.room = values.length;
    } else {
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, values.subarray(0, count * this.stride));
    }
  }

  draw() {
    if (!this.count) return;
    this.gl.bindVertexArray(this.array);
    this.gl.drawArraysInstanced(this.gl.TRIANGLES, 0, this.vertices, this.count);
  }
}

const sum = (numbers) => numbers.reduce((total, number) => total + number, 0);

// A square depth map of `size` × `size` pixels. A shader that reads it gets the result of a comparison: whether a given
// depth is nearer than the depth in the map.
export function depthMap(gl, size) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, size, size);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return { texture, frame, size };
}
