/** The directory of a level: its spatial blocks, where they lie and which anchors they hold. */

import { rawBytes } from "./codecs";
import type { Span } from "./codecs";
import { ViewerError, mismatch } from "../base/errors";
import { codesOf, directoryRecordBytes, hasSplats, nameOf, scalesOf } from "./file-index";
import type { ChunkEntry, Index } from "./file-index";
import * as layout from "./layout.gen";
import { Kind } from "./layout.gen";
import { checkRanges, readRecord } from "./records";
import type { Numbers } from "./records";
import { valuesBytes } from "./values";

/** Block number of the part that all blocks of a level share. */
export const SHARED = -1;

type BlockEntry = Numbers<typeof layout.BLOCK>;

/** One block: its record, anchors new at each level up to its own, and running sums. */
export interface BlockRecord extends BlockEntry {
  /** Number of its anchors that are new at level j. */
  readonly rows: readonly number[];
  /** First table row of those anchors: their number in the whole file, unless `Residency` assigns others. */
  readonly starts: number[];
  /** File offset of its bytes. */
  readonly offset: number;
  /** First table row of its new slots: their number among those of its level, unless `Residency` assigns others. */
  firstSlot: number;
}

/** Raw bytes of the lattice column. */
export function latticeBytes(fresh: number, width: number): number {
  if (!fresh) return 0;
  return width ? MORTON_HEAD + fresh * width : fresh * PLAIN_WIDTH;
}

/** Origin as 3 × i32 and first code as u64, before the steps. */
export const MORTON_HEAD = 20;
const PLAIN_WIDTH = 12;

/** Anchors of a block, inherited and new. */
function anchorsOf(block: Pick<BlockRecord, "rows">): number {
  return block.rows.reduce((sum, n) => sum + n, 0);
}

/** Slots of a block's anchors that were off at the level before: the bits of its mask, which splats have not. */
export function maskBits(index: Index, block: Pick<BlockRecord, "rows" | "before">): number {
  return hasSplats(index.header) ? 0 : anchorsOf(block) * index.header.slots - block.before;
}

/** Bytes of the columns of a block, in their order. */
export function columnBytes(index: Index, level: number, block: Omit<BlockRecord, "offset" | "firstSlot" | "starts">): number[] {
  const entry = index.levels[level];
  const fresh = block.rows[level];
  return [
    latticeBytes(fresh, block.width),
    valuesBytes(entry.log_scales, fresh, scalesOf(index.header)),
    fresh * codesOf(index, level),
    valuesBytes(entry.residual, fresh, index.header.residual),
    Math.ceil(maskBits(index, block) / 8),
    hasSplats(index.header) ? 0 : valuesBytes(entry.offsets, block.live - block.before, 3),
  ];
}

/** A directory from its chunk's bytes, everything checked; `parent` is that of the level before. */
export async function parseDirectory(
  index: Index,
  chunk: ChunkEntry,
  stored: Uint8Array,
  parent: readonly BlockRecord[] | undefined,
): Promise<BlockRecord[]> {
  const where = nameOf(chunk);
  const level = chunk.level;
  if (level && !parent) throw new ViewerError("LayoutError", `${where}: comes before its parent`);
  const raw = await rawBytes(stored, spanOf(chunk), where);
  const blocks = index.chunks.find((c) => c.level === level && c.kind === Kind.blocks)!;
  const starts = index.levels.slice(0, level + 1).map((_, k) => anchorsBefore(index, k));
  const records = readBlocks(raw, level, chunk.rows, { starts, offset: blocks.offset, firstSlot: 0 }, where);
  checkSums(index, level, blocks, records, where);
  checkBlocks(index, level, records, where);
  if (parent) checkParents(level, records, parent, where);
  return records;
}

/** Running sums over the records before a block. */
export type Place = Pick<BlockRecord, "starts" | "offset" | "firstSlot">;

/** `count` records from their byte planes, each field in its range. */
export function readBlocks(raw: Uint8Array, level: number, count: number, place: Place, where: string): BlockRecord[] {
  const size = directoryRecordBytes(level);
  const record = new Uint8Array(size);
  const view = new DataView(record.buffer);
  const starts = place.starts.slice();
  const records: BlockRecord[] = [];
  let { offset, firstSlot } = place;
  for (let b = 0; b < count; b++) {
    for (let i = 0; i < size; i++) record[i] = raw[i * count + b];
    const entry = readRecord(view, 0, layout.BLOCK);
    checkRanges(entry, layout.BLOCK, `${where}: block ${b}`);
    const rows = starts.map((_, k) => view.getUint32(layout.BLOCK_SIZE + 4 * k, true));
    const made = { ...entry, rows, starts: starts.slice(), offset, firstSlot };
    records.push(made);
    rows.forEach((n, k) => (starts[k] += n));
    offset += entry.stored;
    firstSlot += entry.live - entry.before;
  }
  return records;
}

export function checkBlocks(index: Index, level: number, records: readonly BlockRecord[], where: string): void {
  records.forEach((block, b) => {
    checkBlock(index, level, block, `${where}: block ${b}`);
  });
}

export function spanOf(chunk: ChunkEntry): Span {
  return { stored: chunk.stored, raw: chunk.raw, crc: chunk.crc };
}

/** Anchors of the level before, 0 for level 0. */
export function anchorsBefore(index: Index, level: number): number {
  return level ? index.levels[level - 1].anchors : 0;
}

function checkSums(
  index: Index,
  level: number,
  blocks: ChunkEntry,
  records: readonly BlockRecord[],
  where: string,
): void {
  const sum = (of: (block: BlockRecord) => number) => records.reduce((s, block) => s + of(block), 0);
  const check = (name: string, found: number, expected: number) => {
    if (found !== expected) throw mismatch("LayoutError", `${where}: ${name}`, found, expected);
  };
  check("stored", sum((b) => b.stored), blocks.stored);
  check("raw", sum((b) => b.raw), blocks.raw);
  check("live", sum((b) => b.live), index.levels[level].live);
  check("before", sum((b) => b.before), level ? index.levels[level - 1].live : 0);
  for (let k = 0; k <= level; k++) {
    const brought = index.levels[k].anchors - anchorsBefore(index, k);
    check(`rows ${k}`, sum((b) => b.rows[k]), brought);
  }
}

function checkBlock(index: Index, level: number, block: BlockRecord, where: string): void {
  const slots = index.header.slots;
  const total = anchorsOf(block);
  const fresh = block.rows[level];
  const old = total - fresh;
  const raw = columnBytes(index, level, block).reduce((sum, n) => sum + n, 0);
  const rules: [string, boolean][] = [
    ["rows", total <= layout.BLOCK_ROWS_MAX],
    ["live", block.live >= block.before + fresh && block.live <= total * slots],
    ["before", block.before >= old && block.before <= old * slots],
    ["raw", block.raw === raw],
    ["stored", block.stored <= block.raw && (block.stored > 0 || block.raw === 0)],
    ["parent", level > 0 || block.parent === 0],
    ["low_x", block.low_x <= block.high_x],
    ["low_y", block.low_y <= block.high_y],
    ["low_z", block.low_z <= block.high_z],
  ];
  for (const [name, good] of rules) {
    if (!good) throw new ViewerError("LayoutError", `${where}: ${name} does not fit its counts`);
  }
}

/** Blocks or pages as parts of a division. */
type Divided = Pick<BlockRecord, "parent" | "rows" | "live" | "before">;

/** Blocks, or pages, divide their parents, of which the first has a number: in order, none without a child, counts add up. */
export function checkParents(level: number, records: readonly Divided[], parent: readonly Divided[], where: string, first = 0): void {
  const bad = (name: string) =>
    new ViewerError("LayoutError", `${where}: ${name} does not divide the level before`);
  const rows = parent.map(() => new Array<number>(level).fill(0));
  const before = parent.map(() => 0);
  let last = -1;
  for (const block of records) {
    const link = block.parent - first;
    if ((link !== last && link !== last + 1) || !(link in parent)) throw bad("parent");
    last = link;
    for (let k = 0; k < level; k++) rows[last][k] += block.rows[k];
    before[last] += block.before;
  }
  if (last !== parent.length - 1) throw bad("parent");
  parent.forEach((block, p) => {
    if (block.rows.some((n, k) => n !== rows[p][k])) throw bad("rows");
    if (block.live !== before[p]) throw bad("before");
  });
}
