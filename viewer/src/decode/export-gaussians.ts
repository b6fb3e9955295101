/** A level of a file in memory as plain Gaussians, for programs that draw or keep them themselves. */

import type { Assembler } from "../format/assembler";
import { Decoder } from "./anchor-decoder";
import type { Vector } from "./anchor-decoder";
import { ALPHA_MIN } from "./kernel/kernel";
import type { Kernel } from "./kernel/kernel";

/** G Gaussians as seen from one point; those of opacity below 1/255 are left out. */
export interface Gaussians {
  readonly means: Float32Array; // [G, 3] world units
  /** Standard deviations, world units. */
  readonly scales: Float32Array; // [G, 3]
  readonly quats: Float32Array; // [G, 4] w x y z, unit length
  readonly opacities: Float32Array; // [G] in [1/255, 1]
  /** sRGB, 1 is white. */
  readonly colors: Float32Array; // [G, 3]
}

/** A decoder that also lists the slots it decodes: their numbers, and 11 values of each as Python knows them. */
export class ListingDecoder extends Decoder {
  rows: number[] = [];
  numbers: number[] = [];

  /** Decode all of a level, seen from `eye`, and list it alone. */
  list(level: number, eye: Vector): void {
    this.rows = [];
    this.numbers = [];
    const steps = this.refresh(level, eye);
    while (!steps.next().done);
  }

  protected override put(row: number, values: Float32Array, at: number, floats: Float32Array, words: Uint32Array, to: number): void {
    super.put(row, values, at, floats, words, to);
    if (values[at] < ALPHA_MIN) return;
    this.rows.push(row);
    this.numbers.push(...values.subarray(at, at + 11));
  }
}

/**
 * The Gaussians of a level as far as an assembler holds it, seen from `eye` (world units): opacity, scales, rotation and colour depend on it.
 *
 * `level` is capped by the finest whose shared parts are there.
 */
export function gaussiansOf(assembler: Assembler, kernel: Kernel, level: number, eye: Vector): Gaussians {
  const decoder = new ListingDecoder(assembler, kernel);
  decoder.list(level, eye);
  const { rows, numbers } = decoder;
  const centers = decoder.centers(0, assembler.tables.brought.length);
  const columns = (first: number, count: number) =>
    Float32Array.from({ length: rows.length * count }, (_, i) => numbers[11 * Math.floor(i / count) + first + (i % count)]);
  return {
    means: Float32Array.from({ length: 3 * rows.length }, (_, i) => centers[3 * rows[Math.floor(i / 3)] + (i % 3)]),
    scales: columns(1, 3),
    quats: columns(4, 4),
    opacities: columns(0, 1),
    colors: columns(8, 3),
  };
}
