// Matrices of a camera {width, height, fx, fy, cx, cy, w2c}; all are 16 numbers, column by column.
const NEAR = 0.01, FAR = 1000;

/** a times b. */
export function multiply(a, b) {
  return Array.from({ length: 16 }, (_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[(i % 4) + 4 * k] * b[k + 4 * Math.floor(i / 4)], 0));
}

/** Of an affine matrix. */
export function inverse(m) {
  const [a, b, c, , d, e, f, , g, h, i, , x, y, z] = m;
  const n = [e * i - f * h, c * h - b * i, b * f - c * e, f * g - d * i, a * i - c * g, c * d - a * f, d * h - e * g, b * g - a * h, a * e - b * d];
  const k = 1 / (a * n[0] + d * n[1] + g * n[2]);
  const [p, q, r, s, t, u, v, w, o] = n.map((value) => k * value);
  return [p, q, r, 0, s, t, u, 0, v, w, o, 0, -(p * x + s * y + v * z), -(q * x + t * y + w * z), -(r * x + u * y + o * z), 1];
}

/** From a program's world to its camera: axes of view are `signs` times ours, `file` leads from its world to the file's. */
export function view({ w2c }, signs, file) {
  const rows = [0, 1, 2].map((i) => w2c.slice(4 * i, 4 * i + 4).map((value) => signs[i] * value));
  const columns = [0, 1, 2, 3].flatMap((j) => [rows[0][j], rows[1][j], rows[2][j], j === 3 ? 1 : 0]);
  return multiply(columns, file);
}

/** Depths from -1 to 1; `ahead` is the sign of z before the camera, y is up. */
export function projection({ width, height, fx, fy, cx, cy }, ahead) {
  const x = 2 * cx / width - 1, y = 1 - 2 * cy / height;
  const depth = (FAR + NEAR) / (FAR - NEAR), shift = -2 * FAR * NEAR / (FAR - NEAR);
  return [2 * fx / width, 0, 0, 0, 0, 2 * fy / height, 0, 0, ahead * x, ahead * y, ahead * depth, ahead, 0, 0, shift, 0];
}
