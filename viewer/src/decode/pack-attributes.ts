/** A decoded slot as the eight 32-bit words that the vertex shader reads. */

export const WORDS = 8;
/** Slots whose attributes are sent together. */
export const SLOTS_PER_MESSAGE = 1024;

const scratch = new Float32Array(1);
const bits = new Uint32Array(scratch.buffer);

/** Binary16 bits of a number in [0, 1], rounded to nearest; below 2^-14 it becomes 0. */
export function half(value: number): number {
  scratch[0] = value;
  const b = bits[0] + 0x1000;
  const exponent = (b >>> 23) - 112;
  return exponent <= 0 ? 0 : (exponent << 10) | ((b >>> 13) & 1023);
}

/**
 * Covariance (xx, xy, xz, yy, yz, zz as float32), red and green, blue and opacity (as halves).
 *
 * `values` at `from` are 3 standard deviations in world units, the unit quaternion w x y z, RGB.
 */
export function packSlot(
  opacity: number,
  values: Float32Array,
  from: number,
  floats: Float32Array,
  words: Uint32Array,
  to: number,
): void {
  const [sx, sy, sz] = [values[from], values[from + 1], values[from + 2]];
  const w = values[from + 3];
  const x = values[from + 4];
  const y = values[from + 5];
  const z = values[from + 6];
  const ax = (1 - 2 * (y * y + z * z)) * sx;
  const ay = 2 * (x * y - w * z) * sy;
  const az = 2 * (x * z + w * y) * sz;
  const bx = 2 * (x * y + w * z) * sx;
  const by = (1 - 2 * (x * x + z * z)) * sy;
  const bz = 2 * (y * z - w * x) * sz;
  const cx = 2 * (x * z - w * y) * sx;
  const cy = 2 * (y * z + w * x) * sy;
  const cz = (1 - 2 * (x * x + y * y)) * sz;
  floats[to] = ax * ax + ay * ay + az * az;
  floats[to + 1] = ax * bx + ay * by + az * bz;
  floats[to + 2] = ax * cx + ay * cy + az * cz;
  floats[to + 3] = bx * bx + by * by + bz * bz;
  floats[to + 4] = bx * cx + by * cy + bz * cz;
  floats[to + 5] = cx * cx + cy * cy + cz * cz;
  words[to + 6] = half(values[from + 7]) | (half(values[from + 8]) << 16);
  words[to + 7] = half(values[from + 9]) | (half(opacity) << 16);
}
