/** Interface of the decoding kernels; `js.ts` and `wasm.ts` agree bit for bit. */

import type { PackedNetworks } from "../packed-networks";

/** Anchors that a kernel takes at once. */
export const BATCH = 256;
/** Values of a decoded slot: opacity, 3 scale factors, quaternion w x y z, RGB. */
export const SLOT_VALUES = 11;
/** A slot of lower opacity is never drawn; its other values are not computed. */
export const ALPHA_MIN = Math.fround(1 / 255);

/** The anchors of a batch. */
export interface Batch {
  readonly count: number;
  readonly u: Float32Array; // [BATCH, 3] grid coordinates in [0, 1]
  readonly codes: Uint8Array; // [BATCH]
  readonly residual: Float32Array; // [BATCH, R]
}

/** The live slots of a batch. */
export interface Slots {
  readonly count: number;
  readonly owners: Uint32Array; // place of its anchor in the batch
  readonly slots: Uint8Array;
}

export interface Kernel {
  readonly name: "wasm" | "plain";
  /** The heads' first layers without their view inputs, [count, 3 · hidden] into `out`. */
  features(part: PackedNetworks, batch: Batch, out: Float32Array): void;
  /**
   * The heads of live slots, [count, 11] into `out`.
   *
   * `hidden` is what `features` gave, `view` [n, 4] unit directions and normalised distances.
   */
  heads(part: PackedNetworks, n: number, hidden: Float32Array, view: Float32Array, slots: Slots, out: Float32Array): void;
}
