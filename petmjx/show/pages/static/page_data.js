// Reads the data of a page (written by petmjx/show/pages/html_page.py and page_arrays.py).

const KINDS = {
  int8: Int8Array,
  uint8: Uint8Array,
  int16: Int16Array,
  uint16: Uint16Array,
  int32: Int32Array,
  uint32: Uint32Array,
  float32: Float32Array,
  float64: Float64Array,
};
const MISSING = -32768; // stands for NaN

export const readInfo = () => JSON.parse(document.getElementById("info").textContent);

export const hasBlock = (name) => document.getElementById(`block-${name}`) !== null;

// The arrays of a block by name: flat typed arrays, with their shape as `shape`. Resolves to null without a block.
export async function readBlock(name) {
  if (!hasBlock(name)) return null;
  const bytes = await inflated(document.getElementById(`block-${name}`).textContent);
  const length = new DataView(bytes).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  return Object.fromEntries(header.map((column) => [column.name, unpacked(bytes, 4 + length, column)]));
}

async function inflated(base64) {
  const packed = atob(base64);
  const bytes = new Uint8Array(packed.length);
  for (let k = 0; k < packed.length; k++) bytes[k] = packed.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

function unpacked(bytes, start, { type, shape, at, scale, offset, steps }) {
  const count = shape.reduce((product, size) => product * size, 1);
  let values = new KINDS[type](bytes, start + at, count);
  if (steps && count) {
    const row = count / shape[0];
    for (let k = row; k < count; k++) values[k] += values[k - row];
  }
  if (scale !== undefined) {
    values = Float32Array.from(values, (part) => (part === MISSING ? NaN : part * scale + offset));
  }
  values.shape = shape;
  return values;
}
