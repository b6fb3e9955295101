/** Ranges of a file that can be requested, with those that each needs and the regions that it improves; as stream/catalog.py. */

import type { Assembler } from "../format/assembler";
import { SHARED } from "../format/directory";
import { Kind } from "../format/layout.gen";
import { parseBlockUtility } from "../format/notes/block-utility";
import { boxOf } from "./visibility";
import type { Box } from "./visibility";

/** PSNR against the full model above which nobody sees a difference, dB. */
export const FULL_DB = 50;
/** Figures of a file beyond this, either way, count as this: anybody may have written them. */
const DB_MAX = 300;
/** Guess of what a level adds where a file carries no quality, dB. */
const STEP_DB = 4;
const LEAST = 10 ** (-FULL_DB / 10);

/** A range that is requested as one; others name it by its number in the catalog. */
export interface Item {
  readonly level: number;
  readonly block: number;
  /** First byte. */
  readonly start: number;
  readonly size: number;
  /** Items without which it is of no use, in the order to request them. */
  readonly needs: readonly number[];
  /** Leaves that it brings to its level. */
  readonly region: ArrayLike<number>;
  /** Splats that it adds. */
  readonly slots: number;
}

export interface Catalog {
  /** In the order of the file. */
  readonly items: readonly Item[];
  /** Mean squared error against the full model where a level shows a leaf, [levels][leaves]. */
  readonly errors: readonly Float64Array[];
  /** The file has a note on block utilities; without it all leaves of a level count alike. */
  readonly measured: boolean;
  /** Smallest regions that can differ in level. */
  readonly leaves: number;
}

/** The catalog of a file whose directories are known, its coarsest `levels` of them. */
export function catalogOf(assembler: Assembler, levels: number): Catalog {
  const { index, directories } = assembler;
  const { lineage } = leavesOf(assembler);
  const leaves = lineage[0].length;
  const items: Item[] = [];
  let above: number[] = [];
  let shared = -1;
  for (let level = 0; level < levels; level++) {
    const records = directories[level];
    const chunks = index.chunks.filter((c) => c.level === level && !([Kind.manifest, Kind.directory, Kind.blocks] as number[]).includes(c.kind));
    const size = chunks.reduce((sum, chunk) => sum + chunk.stored, 0);
    const needs = level ? [shared] : [];
    // A level of splats without harmonics, or with the codebook of the level before, shares nothing of its own.
    if (chunks.length || !level) shared = items.length;
    const start = Math.min(...chunks.map((chunk) => chunk.offset), ...(level ? [] : records.map((record) => record.offset)));
    if (!level) {
      const all = size + records.reduce((sum, record) => sum + record.stored, 0);
      const region = Array.from({ length: leaves }, (_, leaf) => leaf);
      items.push({ level, block: SHARED, start, size: all, needs, region, slots: index.levels[0].live });
      above = records.map(() => shared);
      continue;
    }
    if (chunks.length) items.push({ level, block: SHARED, start, size, needs, region: [], slots: 0 });
    const regions = records.map((): number[] => []);
    lineage[level].forEach((block, leaf) => { if (block !== UNKNOWN) regions[block].push(leaf); });
    const parents = above;
    above = records.map((record, block) => {
      const slots = record.live - record.before;
      const own = { start: record.offset, size: record.stored, needs: [parents[record.parent], shared] };
      items.push({ level, block, ...own, region: regions[block], slots });
      return items.length - 1;
    });
  }
  const gains = assembler.pages ? null : parseBlockUtility(assembler.manifest?.meta.gains ?? "", directories.slice(1).map((records) => records.length));
  const quality = assembler.manifest?.quality ?? [];
  const even = errorsOf(index.levels.map((_, level) => (quality.at(level) ?? {}).psnr_full as number | undefined));
  const errors = gains ? tableOf(gains, lineage) : even.map((error) => new Float64Array(leaves).fill(error));
  return { items, errors: errors.slice(0, levels), measured: gains !== null, leaves };
}

/** Errors of leaves from the utilities of their blocks. */
function tableOf(gains: readonly Float64Array[], lineage: readonly Int32Array[]): Float64Array[] {
  let below = new Float64Array(lineage[0].length).fill(LEAST);
  const table = [below];
  for (let level = gains.length; level > 0; level--) {
    below = below.map((error, leaf) => error + gains[level - 1][lineage[level][leaf]]);
    table.unshift(below);
  }
  return table;
}

/** Block number where no page has come that lists the block. */
export const UNKNOWN = -1;

export interface Leaves {
  /** Block that holds each leaf, or `UNKNOWN`, [levels][leaves]. */
  readonly lineage: readonly Int32Array[];
  readonly boxes: readonly Box[];
}

/** The finest level's blocks; where pages of it have not come, those that these divide. */
export function leavesOf(assembler: Assembler): Leaves {
  const { directories, pages } = assembler;
  const { voxel } = assembler.index.header;
  const last = directories.length - 1;
  if (!pages) return { lineage: ancestors(assembler), boxes: directories[last].map((record) => boxOf(record, voxel)) };
  const lineage = directories.map((): number[] => []);
  const boxes: Box[] = [];
  directories.forEach((records, level) => {
    // Where a page has not come, `directories` is empty, and is not visited.
    records.forEach((record, number) => {
      if (level < last && pages.hasPage(level + 1, pages.pageUnder(level + 1, number))) return;
      boxes.push(boxOf(record, voxel));
      for (let k = last; k > level; k--) lineage[k].push(UNKNOWN);
      for (let k = level, block = number; k >= 0; block = directories[k--][block].parent) lineage[k].push(block);
    });
  });
  return { lineage: lineage.map((blocks) => Int32Array.from(blocks)), boxes };
}

/** Block that holds each leaf, [levels][leaves]; leaves are the finest level's blocks. */
function ancestors({ directories }: Assembler): Int32Array[] {
  let blocks = Int32Array.from(directories[directories.length - 1], (_, block) => block);
  const lineage = [blocks];
  for (let level = directories.length - 1; level > 0; level--) {
    const records = directories[level];
    blocks = blocks.map((block) => records[block].parent);
    lineage.unshift(blocks);
  }
  return lineage;
}

/** Errors against the full model from each level's PSNR against photos. */
export function errorsOf(psnr: readonly (number | undefined)[]): number[] {
  const known = psnr.every((value) => value !== undefined);
  let most = -Infinity;
  const stated = (value: number) => (most = Math.max(most, Math.min(Math.max(value, -DB_MAX), DB_MAX)));
  const values = psnr.map((value, level) => (known ? stated(value!) : 30 - STEP_DB * (psnr.length - 1 - level)));
  const mse = values.map((value) => 10 ** (-value / 10));
  return mse.map((value) => Math.max(value - mse[mse.length - 1], LEAST));
}
