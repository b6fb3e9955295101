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
