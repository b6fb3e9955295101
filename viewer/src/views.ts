/** Cameras as the policy sees them: the share of the picture that each region's box takes. */

import type { BlockRecord } from "./directory";
import type { Eye } from "./messages";

/** Sample points per axis of a region's box. */
const POINTS = 4;
/** Nearer than this share of a box's size, a camera is taken to stand in it. */
const NEAR = 0.05;
const PIXELS = 2e6;

/** Low x, y, z and high x, y, z of a box, world units. */
export type Box = readonly [number, number, number, number, number, number];

export function boxOf(block: BlockRecord, voxel: number): Box {
  const { reach } = block;
  return [
    block.low_x * voxel - reach,
    block.low_y * voxel - reach,
    block.low_z * voxel - reach,
    block.high_x * voxel + reach,
    block.high_y * voxel + reach,
    block.high_z * voxel + reach,
  ];
}

/** The share of the picture of each box; they sum to 1 if any is seen. */
export function shares(boxes: readonly Box[], eye: Eye): Float64Array {
  const areas = Float64Array.from(boxes, (box) => area(box, eye));
  const total = areas.reduce((sum, value) => sum + value, 0);
  return total > 0 ? areas.map((value) => value / total) : areas;
}

function area(box: Box, eye: Eye): number {
  const [dx, dy, dz] = [box[3] - box[0], box[4] - box[1], box[5] - box[2]];
  const size = Math.sqrt(dx * dx + dy * dy + dz * dz);
  const [a, b, c, d, e, f, g, h, i, j, k, l] = eye.w2c;
  const least = NEAR * size + 1e-9;
  let sum = 0;
  for (let p = 0; p < POINTS ** 3; p++) {
    const x = box[0] + ((Math.floor(p / (POINTS * POINTS)) + 0.5) / POINTS) * dx;
    const y = box[1] + (((Math.floor(p / POINTS) % POINTS) + 0.5) / POINTS) * dy;
    const z = box[2] + (((p % POINTS) + 0.5) / POINTS) * dz;
    const seen = i * x + j * y + k * z + l;
    const depth = Math.max(seen, least);
    const inside =
      seen > 0 &&
      Math.abs(a * x + b * y + c * z + d) < eye.right * depth &&
      Math.abs(e * x + f * y + g * z + h) < eye.up * depth;
    // A sample stands for the box's faces seen from the side: about size² / 3 over all samples.
    if (inside) sum += Math.min(1, (size * size) / 3 / (depth * depth * 4 * eye.right * eye.up));
  }
  const mean = sum / POINTS ** 3;
  return mean * PIXELS < 1 ? 0 : mean;
}

/** Shares now and at moments ahead, all leaves alike where nothing is seen. */
export function sharesOver(boxes: readonly Box[], eyes: readonly Eye[]): Float64Array[] {
  const even = new Float64Array(boxes.length).fill(1 / boxes.length);
  let last: { eye: Eye; found: Float64Array } | null = null;
  return eyes.map((eye) => {
    if (last?.eye === eye) return last.found;
    const found = shares(boxes, eye);
    const seen = found.some((value) => value > 0) ? found : even;
    last = { eye, found: seen };
    return seen;
  });
}

/**
 * Where a camera will be after `times` seconds if it goes on moving as from `before` to `now`, which
 * lie `step` seconds apart: position and rotation go on at constant speed.
 */
export function extrapolated(before: Eye, now: Eye, step: number, times: readonly number[]): Eye[] {
  const [axis, angle] = axisAngle(before.w2c, now.w2c);
  return times.map((time) => {
    const turn = rotation(axis, (angle * time) / step);
    const position = now.position.map((value, i) => value + ((value - before.position[i]) * time) / step) as [number, number, number];
    const w2c = [0, 1, 2].flatMap((i) => {
      const row = [0, 1, 2].map((j) => [0, 1, 2].reduce((sum, k) => sum + turn[3 * i + k] * now.w2c[4 * k + j], 0));
      return [...row, -row.reduce((sum, value, j) => sum + value * position[j], 0)];
    });
    return { ...now, w2c, position };
  });
}

/** Unit axis and angle in [0, π] of the turn between two world-to-camera matrices. */
function axisAngle(before: readonly number[], now: readonly number[]): [number[], number] {
  const at = (i: number, j: number) => [0, 1, 2].reduce((sum, k) => sum + now[4 * i + k] * before[4 * j + k], 0);
  const skew = [at(2, 1) - at(1, 2), at(0, 2) - at(2, 0), at(1, 0) - at(0, 1)];
  const length = Math.hypot(...skew);
  const angle = Math.atan2(length, at(0, 0) + at(1, 1) + at(2, 2) - 1);
  return [length > 1e-12 ? skew.map((value) => value / length) : [0, 0, 1], angle];
}

/** Rodrigues' formula, rows of a 3 × 3 matrix. */
function rotation([x, y, z]: readonly number[], angle: number): number[] {
  const [s, c] = [Math.sin(angle), 1 - Math.cos(angle)];
  return [
    1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y,
    c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x,
    c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y),
  ];
}
