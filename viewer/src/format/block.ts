/** The bytes of one spatial block: its new anchors, and the slots that become live in it. */

import { fromPlanes, rawBytes } from "./codecs";
import { MORTON_HEAD, columnBytes, maskBits } from "./directory";
import type { BlockRecord } from "./directory";
import { ViewerError, mismatch } from "../base/errors";
import { freeMemory } from "../base/free-memory";
import { codesOf, hasSplats, hasSteps, scalesOf, viewOf } from "./file-index";
import type { Index } from "./file-index";
import { SPLAT_SCALES, SPLAT_VALUES } from "./layout.gen";
import { decodeSteps, decodeValues } from "./values";

/** Values, or numbers of steps that stand for them. */
export type Values = Float32Array | Uint16Array;

/** The decoded values of one block: rows are its new anchors or its new live slots. */
export type Block = {
  readonly lattice: Int32Array; // [fresh, 3]
  readonly logScales: Values; // [fresh, 6], of splats [fresh, 3]
  readonly codes: Uint8Array; // [fresh], or [0] without a codebook; of splats [fresh, S]
  readonly residual: Values; // [fresh, R]
  /** The least value and the step of each column of `logScales`, then of `residual`: 0 and 1 of those that are values. */
  readonly affine: Float32Array; // of splats [3 + R, 2], else [0]
  readonly mask: Uint8Array; // bits, lowest first, of slots that were off before; of splats none
  readonly offsets: Float32Array; // [added, 3], of splats [0]
};

/** The bytes of one block, and what is known of it. */
export interface Packed {
  readonly level: number;
  readonly record: BlockRecord;
  readonly stored: Uint8Array;
  readonly where: string;
}

/** The values of a block whose checksum is right. */
export async function unpackBlock({ level, record, stored, where }: Packed, index: Index): Promise<Block> {
  const raw = await rawBytes(stored, record, where);
  const block = decodeBlock(raw, index, level, record, where);
  if (raw !== stored) freeMemory(raw);
  return block;
}

/** The values of a block from inflated bytes of the right length. */
export function decodeBlock(
  raw: Uint8Array,
  index: Index,
  level: number,
  record: BlockRecord,
  where: string,
): Block {
  const entry = index.levels[level];
  const fresh = record.rows[level];
  const splats = hasSplats(index.header);
  const added = splats ? 0 : record.live - record.before;
  const affine = Float32Array.from({ length: splats ? 2 * (SPLAT_SCALES + SPLAT_VALUES) : 0 }, (_, i) => i % 2);
  const steps = hasSteps(index);
  const valuesOf = (coding: number, bytes: Uint8Array, from: number, count: number) => steps
    ? decodeSteps(bytes, fresh, affine.subarray(2 * from, 2 * (from + count)), where)
    : decodeValues(coding, bytes, fresh, count, where);
  let at = 0;
  const [lattice, scales, codes, residual, mask, offsets] = columnBytes(index, level, record).map(
    (length) => raw.subarray(at, (at += length)),
  );
  checkMask(mask, maskBits(index, record), added, where);
  const block = {
    lattice: decodeLattice(lattice, fresh, record.width, where),
    logScales: valuesOf(entry.log_scales, scales, 0, scalesOf(index.header)),
    codes: new Uint8Array(fromPlanes(codes, fresh, codesOf(index, level), 1)),
    residual: valuesOf(entry.residual, residual, SPLAT_SCALES, index.header.residual),
    affine,
    mask: mask.slice(),
    offsets: decodeValues(entry.offsets, offsets, added, 3, where),
  };
  checkValues(block, index, level, record, where);
  return block;
}

function checkMask(mask: Uint8Array, bits: number, live: number, where: string): void {
  let count = 0;
  for (const byte of mask) {
    let b = byte - ((byte >> 1) & 0x55);
    b = (b & 0x33) + ((b >> 2) & 0x33);
    count += (b + (b >> 4)) & 15;
  }
  const padding = bits % 8 ? mask[mask.length - 1] >> (bits % 8) : 0;
  if (padding) throw new ViewerError("LayoutError", `${where}: padding bits set`);
  if (count !== live) throw mismatch("LayoutError", `${where}: new live slots`, count, live);
}

/** Codes and coordinates lie in their ranges. */
function checkValues(
  block: Block,
  index: Index,
  level: number,
  record: BlockRecord,
  where: string,
): void {
  const levels = index.levels.slice(level, hasSplats(index.header) ? level + 1 : undefined);
  const entries = Math.min(...levels.map((l) => l.codebook_rows));
  for (const code of block.codes) {
    if (code >= entries) throw mismatch("ValueRangeError", where, `code ${code}`, `below ${entries}`);
  }
  const low = [record.low_x, record.low_y, record.low_z];
  const high = [record.high_x, record.high_y, record.high_z];
  const { lattice } = block;
  for (let i = 0, axis = 0; i < lattice.length; i++, axis = axis === 2 ? 0 : axis + 1) {
    const value = lattice[i];
    if (value < low[axis] || value > high[axis]) {
      const found = `${"xyz"[axis]} = ${value}`;
      throw mismatch("ValueRangeError", where, found, `${low[axis]} to ${high[axis]}`);
    }
  }
}

/** Lattice coordinates, int32 [fresh, 3]. */
export function decodeLattice(
  raw: Uint8Array,
  fresh: number,
  width: number,
  where: string,
): Int32Array {
  if (!width || !fresh) return new Int32Array(fromPlanes(raw, fresh, 3, 4));
  const lattice = new Int32Array(fresh * 3);
  const view = viewOf(raw);
  const origin = [0, 4, 8].map((at) => view.getInt32(at, true));
  // The running code in two halves of 32 bits; additions stay exact in doubles.
  let low = view.getUint32(12, true);
  let high = view.getUint32(16, true);
  for (let i = 0; i < fresh; i++) {
    for (let b = width - 1, part = 0; b >= 0; b--) {
      part = part * 256 + raw[MORTON_HEAD + b * fresh + i];
      if (b === 4) {
        high += part;
        part = 0;
      } else if (b === 0) low += part;
    }
    if (low >= 2 ** 32) {
      low -= 2 ** 32;
      high++;
    }
    if (high >= 2 ** 31) {
      throw new ViewerError("LayoutError", `${where}: a Morton code above 2^63`);
    }
    const middle = ((low >>> 30) | (high << 2)) & 0x3fffffff;
    for (let axis = 0; axis < 3; axis++) {
      const bits =
        everyThird(low >> axis) | (everyThird(middle >> axis) << 10) | (((high >>> (28 + axis)) & 1) << 20);
      const value = origin[axis] + bits;
      if (value > 0x7fffffff) {
        throw new ViewerError("LayoutError", `${where}: a coordinate above 2^31 - 1`);
      }
      lattice[3 * i + axis] = value;
    }
  }
  return lattice;
}

/** Bits 0, 3, 6, … 27 of a number, next to each other. */
function everyThird(bits: number): number {
  let v = bits & 0x09249249;
  v = (v | (v >> 2)) & 0x030c30c3;
  v = (v | (v >> 4)) & 0x0300f00f;
  v = (v | (v >> 8)) & 0x030000ff;
  return (v | (v >> 16)) & 0x3ff;
}
