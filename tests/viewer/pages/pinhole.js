// A pinhole camera (OpenCV axes, pixels) as the matrices of engines: 16 numbers, column after column.

/** World to camera with y up, looking along -z. */
export function viewOf({ w2c }) {
  const rows = [w2c.slice(0, 4), w2c.slice(4, 8).map((v) => -v), w2c.slice(8, 12).map((v) => -v), [0, 0, 0, 1]];
  return [0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column]));
}

/** Camera to clip space. */
export function projectionOf({ width, height, fx, fy, cx, cy }, near, far) {
  const depth = 1 / (near - far);
  return [
    (2 * fx) / width, 0, 0, 0,
    0, (2 * fy) / height, 0, 0,
    1 - (2 * cx) / width, (2 * cy) / height - 1, (near + far) * depth, -1,
    0, 0, 2 * near * far * depth, 0,
  ];
}

/** What `draw` gave, top row first and as text. */
export function packed({ width, height, pixels, ...rest }) {
  const row = pixels.length / height;
  const out = new pixels.constructor(pixels.length);
  for (let y = 0; y < height; y++) out.set(pixels.subarray((height - 1 - y) * row, (height - y) * row), y * row);
  return { width, height, pixels: bytes(new Uint8Array(out.buffer)), ...rest };
}
globalThis.packed = packed;
