/** Coverage of the image by each region's box, now and ahead; as stream/views.py. */

import type { BlockRecord } from "../format/directory";
import type { ViewPose } from "../base/view-pose";

/** Parts of a region's box per axis; the second where there are more than `MANY`, of which each shows little. */
const POINTS = 4;
const FEWER_POINTS = 2;
const MANY = 1024;
/** Share of the picture that comes from boxes that seem not to be in it. */
export const LEAK = 0.005;

/** Low x, y, z and high x, y, z of a box, world units. */
export type Box = readonly [number, number, number, number, number, number];

/** The cells of a block's anchors, which say more of where it is seen than the reach of its largest splat. */
export function boxOf(block: BlockRecord, voxel: number): Box {
  const { low_x, low_y, low_z, high_x, high_y, high_z } = block;
  const [low, high] = [[low_x, low_y, low_z], [high_x, high_y, high_z]];
  return [...low.map((at) => (at - 0.5) * voxel), ...high.map((at) => (at + 0.5) * voxel)] as unknown as Box;
}

/** The share of the picture that the parts of each box cover; they sum to 1 if any is seen. */
export function coverage(boxes: readonly Box[], eye: ViewPose): Float64Array {
  const points = boxes.length > MANY ? FEWER_POINTS : POINTS;
  const areas = Float64Array.from(boxes, (box) => area(box, eye, points));
  const total = areas.reduce((sum, value) => sum + value, 0);
  return total > 0 ? areas.map((value) => ((1 - LEAK) * value) / total + LEAK / boxes.length) : areas;
}

function area(box: Box, eye: ViewPose, points: number): number {
  const [dx, dy, dz] = [box[3] - box[0], box[4] - box[1], box[5] - box[2]];
  const [a, b, c, d, e, f, g, h, i, j, k, l] = eye.w2c;
  const half = Math.hypot(dx, dy, dz) / (2 * points * Math.sqrt(3)) + 1e-9;
  let sum = 0;
  for (let p = 0; p < points ** 3; p++) {
    const x = box[0] + ((Math.floor(p / (points * points)) + 0.5) / points) * dx;
    const y = box[1] + (((Math.floor(p / points) % points) + 0.5) / points) * dy;
    const z = box[2] + (((p % points) + 0.5) / points) * dz;
    const seen = i * x + j * y + k * z + l;
    if (seen <= -half) continue;
    const depth = Math.max(seen, half);
    sum += overlap(a * x + b * y + c * z + d, half, depth * eye.right) * overlap(e * x + f * y + g * z + h, half, depth * eye.up);
  }
  // Parts lie behind one another, `points` deep.
  return Math.min(sum / points, 1);
}

/** Share of [-edge, edge] that an interval around a centre covers, 0 to 1. */
function overlap(center: number, half: number, edge: number): number {
  const right = Math.min((center + half) / edge, 1);
  return Math.max(right - Math.max((center - half) / edge, -1), 0) / 2;
}

/** `coverage` now and at moments ahead, all leaves alike where nothing is seen. */
export function coverageOver(boxes: readonly Box[], eyes: readonly ViewPose[]): Float64Array[] {
  const even = new Float64Array(boxes.length).fill(1 / boxes.length);
  let last: { eye: ViewPose; found: Float64Array } | null = null;
  return eyes.map((eye) => {
    if (last?.eye === eye) return last.found;
    const found = coverage(boxes, eye);
    const seen = found.some((value) => value > 0) ? found : even;
    last = { eye, found: seen };
    return seen;
  });
}

/**
 * Poses of a camera after `times` seconds if it goes on moving as from `before` to `now`, which
 * lie `step` seconds apart: position and rotation go on at constant speed.
 */
export function extrapolate(before: ViewPose, now: ViewPose, step: number, times: readonly number[]): ViewPose[] {
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
