/** Header and tables of a .gsyn file, everything checked before anything is allocated by them. */

import { crc32 } from "./codecs";
import { ViewerError, mismatch } from "../base/errors";
import * as layout from "./layout.gen";
import { Kind } from "./layout.gen";
import { checkRanges, expectEqual, must, readRecord } from "./records";
import type { Numbers } from "./records";
import { areSteps, valuesBytes } from "./values";

export type Header = Numbers<typeof layout.HEADER>;
export type LevelEntry = Numbers<typeof layout.LEVEL>;
export type ChunkEntry = Numbers<typeof layout.CHUNK>;

export interface Index {
  readonly header: Header;
  readonly levels: readonly LevelEntry[];
  readonly chunks: readonly ChunkEntry[];
  /** Bytes of header and tables; the first chunk begins there. */
  readonly length: number;
}

/** One matrix or bias of a level's networks: its name, rows and columns. */
export interface WeightShape {
  readonly name: string;
  readonly rows: number;
  readonly columns: number;
  readonly matrix: boolean;
}

export const HEADS = [
  ["opacity", 1],
  ["cov", 7],
  ["color", 3],
] as const;
/** Unit viewing direction (3) and normalised distance (1). */
export const VIEW_INPUTS = 4;
/** Values of spherical harmonics of degree 0 to 3 beyond the first of each colour. */
const HARMONICS = [0, 9, 24, 45];
/** Position, log-scales and other values of a splat, and its first harmonics. */
const SPLAT_NUMBERS = 14;
/** Bytes that a record of a page table is longer than a directory's. */
const PAGE_MORE = layout.PAGE_SIZE - layout.BLOCK_SIZE;

/** True if rows are splats: Gaussians with values of their own, not anchors. */
export function hasSplats({ required }: Header): boolean {
  return (required & layout.SPLATS) !== 0;
}

/** True if directories are in pages. */
export function hasPages({ required }: Header): boolean {
  return (required & layout.PAGES) !== 0;
}

/** Codes of a row that a level brings: 1 with a codebook, with splats one for each stage. */
export function codesOf({ header, levels }: Index, level: number): number {
  const { codebook_rows, codebook_columns } = levels[level];
  return hasSplats(header) ? Math.floor(codebook_columns / (header.features || 1)) : Number(codebook_rows > 0);
}

/** Log-scales of a row. */
export function scalesOf(header: Header): number {
  return (hasSplats(header) ? 1 : 2) * layout.SPLAT_SCALES;
}

/** Width of the view-independent features of a level. */
export function inputWidth(header: Header, level: LevelEntry): number {
  return level.grids * header.features + level.codebook_columns + header.residual;
}

/** Features, hidden values and outputs of one anchor on its way through the networks. */
function valuesPerAnchor(header: Header, level: LevelEntry): number {
  if (hasSplats(header)) return SPLAT_NUMBERS + header.features;
  const outputs = HEADS.reduce((sum, [, count]) => sum + count, 0);
  const heads = HEADS.length * level.head_hidden + outputs * header.slots;
  return inputWidth(header, level) + level.fuse_hidden + level.fuse_out + heads;
}

/** Names and shapes of a level's networks. */
export function networkShapes(header: Header, level: LevelEntry): WeightShape[] {
  const shapes: WeightShape[] = [];
  const affine = (net: string, layer: number, rows: number, columns: number): void => {
    shapes.push({ name: `${net}_w${layer}`, rows, columns, matrix: true });
    shapes.push({ name: `${net}_b${layer}`, rows, columns: 1, matrix: false });
  };
  let width = inputWidth(header, level);
  if (level.fuse_hidden) {
    affine("fuse", 1, level.fuse_hidden, width);
    affine("fuse", 2, level.fuse_out, level.fuse_hidden);
    width = level.fuse_out;
  }
  for (const [head, outputs] of HEADS) {
    affine(head, 1, level.head_hidden, width + VIEW_INPUTS);
    affine(head, 2, outputs * header.slots, level.head_hidden);
  }
  return shapes;
}

/** Networks in the level's own chunk, in its order: biases alone if it inherits. */
export function ownShapes(header: Header, level: LevelEntry): WeightShape[] {
  return networkShapes(header, level).filter(({ matrix }) => !(level.inherits && matrix));
}

/** Bytes of header and tables, from at least the bytes of the header. */
export function indexLength(data: Uint8Array): number {
  if (layout.MAGIC.some((byte, i) => i < data.length && data[i] !== byte)) {
    throw new ViewerError("NotGsynError", "This is no .gsyn file.");
  }
  if (data.length < layout.HEADER_SIZE) {
    throw mismatch("TruncatedError", "header", `${data.length} bytes`, layout.HEADER_SIZE);
  }
  const header = readRecord(viewOf(data), 0, layout.HEADER);
  const known = layout.VERSION as number;
  // Bits of `required` that are not known.
  const unknown = (header.required & ~layout.KNOWN_FEATURES) >>> 0;
  if (header.version !== known || unknown) {
    const what = unknown ? `needs features ${unknown}` : `has version ${header.version}`;
    throw new ViewerError(
      "VersionError",
      `The file ${what}, this viewer knows version ${known}: a newer viewer is needed.`,
    );
  }
  checkRanges(header, layout.HEADER, "header");
  const length = layout.HEADER_SIZE + header.levels * layout.LEVEL_SIZE + header.chunks * layout.CHUNK_SIZE;
  if (length > layout.INDEX_BYTES_MAX) {
    throw mismatch("LayoutError", "index", `${length} bytes`, `at most ${layout.INDEX_BYTES_MAX}`);
  }
  return length;
}

/** Header and tables of a file whose first bytes are given. */
export function parseIndex(data: Uint8Array): Index {
  const length = indexLength(data);
  if (data.length < length) {
    throw mismatch("TruncatedError", "index", `${data.length} bytes`, length);
  }
  const view = viewOf(data);
  const header = readRecord(view, 0, layout.HEADER);
  const blank = data.slice(0, length);
  blank.fill(0, layout.HEADER.crc.offset, layout.HEADER.crc.offset + 4);
  if (crc32(blank) !== header.crc) {
    throw new ViewerError("ChecksumError", "index: the bytes were changed, load the file again");
  }
  const second = length - header.chunks * layout.CHUNK_SIZE;
  const levels = Array.from({ length: header.levels }, (_, k) =>
    readRecord(view, layout.HEADER_SIZE + k * layout.LEVEL_SIZE, layout.LEVEL),
  );
  const chunks = Array.from({ length: header.chunks }, (_, i) =>
    readRecord(view, second + i * layout.CHUNK_SIZE, layout.CHUNK),
  );
  const index = { header, levels, chunks, length };
  checkLevels(header, levels);
  checkChunks(index);
  return index;
}

/** True of a file of splats all of whose values are numbers of steps. */
export function hasSteps({ header, levels }: Index): boolean {
  return hasSplats(header) && levels.every(({ log_scales, residual }) => areSteps(log_scales) && areSteps(residual));
}

/** Number of levels in a file of this length, at least one. */
export function checkLength(index: Index, length: number): number {
  const ends = index.levels.map((level) => level.end);
  const found = ends.indexOf(length);
  if (found < 0) {
    const expected = `the end of a level (${ends.join(", ")}); load the file again`;
    throw mismatch("TruncatedError", "length", `${length} bytes`, expected);
  }
  return found + 1;
}

export function viewOf(data: Uint8Array): DataView {
  return new DataView(data.buffer, data.byteOffset, data.byteLength);
}

export function nameOf(chunk: ChunkEntry): string {
  if (chunk.kind === Kind.manifest) return "manifest";
  const kind = Object.entries(Kind).find(([, number]) => number === chunk.kind);
  const part = chunk.kind === Kind.grid ? ` ${chunk.part}` : "";
  return `level ${chunk.level} ${kind?.[0] ?? ""}${part}`;
}

function checkLevels(header: Header, levels: readonly LevelEntry[]): void {
  checkInherited(header, levels);
  expectEqual(header.required & layout.STAND_INS, header.stand_ins ? layout.STAND_INS : 0, "header: required");
  if (header.stand_ins >= (hasSplats(header) ? levels.length : 1)) throw mismatch("LayoutError", "header: stand_ins", header.stand_ins, "fewer than levels");
  (hasSplats(header) ? checkSplats : checkAnchors)(header, levels);
  let before = { anchors: 0, live: 0, grids: 0 };
  levels.forEach((level, k) => {
    const where = `level ${k}`;
    checkRanges(level, layout.LEVEL, where);
    if (level.fuse_hidden > 0 !== level.fuse_out > 0) {
      throw mismatch("LayoutError", `${where}: fuse_out`, level.fuse_out, "0 with fuse_hidden");
    }
    for (const name of ["anchors", "live", "grids"] as const) {
      if (level[name] < before[name]) {
        throw mismatch("LayoutError", `${where}: ${name}`, level[name], `at least ${before[name]}`);
      }
    }
    const least = before.live + level.anchors - before.anchors;
    const most = level.anchors * header.slots;
    if (level.live < least || level.live > most) {
      throw mismatch("LayoutError", `${where}: live`, level.live, `${least} to ${most}`);
    }
    if (level.blocks > Math.max(1, level.anchors)) {
      throw mismatch("LayoutError", `${where}: blocks`, level.blocks, `at most ${level.anchors}, an anchor each`);
    }
    before = level;
  });
}

/** Checks that levels of anchors agree with each other. */
function checkAnchors(header: Header, levels: readonly LevelEntry[]): void {
  const coded = new Set(levels.filter((l) => l.anchors).map((l) => l.codebook_rows > 0));
  if (coded.size > 1) throw mismatch("LayoutError", "codebook_rows", "0 at some levels", "at all");
  const last = levels[levels.length - 1];
  if (header.features > 0 !== last.grids > 0) {
    throw mismatch("LayoutError", "header: features", header.features, `for ${last.grids} grids`);
  }
  levels.forEach(({ head_hidden }, k) => {
    if (!head_hidden) throw mismatch("LayoutError", `level ${k}: head_hidden`, 0, "at least 1");
  });
}

/** Checks on levels of splats, which have no networks and grids. */
function checkSplats(header: Header, levels: readonly LevelEntry[]): void {
  const { features } = header;
  expectEqual(header.slots, 1, "header: slots");
  expectEqual(header.residual, layout.SPLAT_VALUES, "header: residual");
  expectEqual(header.contract, 0, "header: contract");
  if (!HARMONICS.includes(features)) throw mismatch("LayoutError", "header: features", features, HARMONICS.join(" or "));
  levels.forEach((level, k) => {
    for (const name of ["grids", "head_hidden", "fuse_hidden", "fuse_out", "offsets"] as const) {
      expectEqual(level[name], 0, `level ${k}: ${name}`);
    }
    expectEqual(level.live, level.anchors, `level ${k}: live`);
    const { codebook_rows: rows, codebook_columns: columns } = level;
    const stages = Math.floor(columns / (features || 1));
    if (stages * features !== columns || rows > 0 !== columns > 0 || stages > layout.STAGES_MAX) {
      const expected = `rows of 1 to ${layout.STAGES_MAX} times ${features} values, or none`;
      throw mismatch("LayoutError", `level ${k}: codebook_rows`, `${rows} rows of ${columns}`, expected);
    }
  });
}

/** Matrices can be those of the level before, and readers that know no such thing are warned. */
function checkInherited(header: Header, levels: readonly LevelEntry[]): void {
  const bit = levels.some((level) => level.inherits) ? layout.TIED_WEIGHTS : 0;
  expectEqual(header.required & layout.TIED_WEIGHTS, bit, "header: required");
  levels.forEach((level, k) => {
    if (!level.inherits) return;
    const where = `level ${k}: inherits`;
    if (!k) throw mismatch("LayoutError", where, 1, "0 at level 0");
    const splats = hasSplats(header);
    const [own, before] = [level, levels[k - 1]].map((entry) =>
      JSON.stringify(splats ? [entry.codebook_rows, entry.codebook_columns] : networkShapes(header, entry)));
    if (own !== before || (splats && !level.codebook_rows && !level.codebook_columns)) {
      throw mismatch("LayoutError", where, 1, `0, or ${splats ? "a codebook of the same size" : "networks of the same sizes"}`);
    }
  });
}

/** The level whose chunk holds the matrices of a level's networks; with splats its codebook. */
export function ownerOf(index: Index, level: number): number {
  while (index.levels[level].inherits) level--;
  return level;
}

interface Want {
  readonly kind: number;
  readonly level: number;
  readonly part: number;
  readonly rows: number | null;
}

/** All chunks of a file in their order, as its counts call for them. */
function plan(header: Header, levels: readonly LevelEntry[]): Want[] {
  const wants: Want[] = [];
  const want = (kind: number, level: number, rows: number | null, part = 0): void => { wants.push({ kind, level, rows, part }); };
  const directory = (level: number): void => { want(Kind.directory, level, hasPages(header) ? null : levels[level].blocks); };
  want(Kind.manifest, 0, null);
  if (header.front) levels.forEach((_, k) => { directory(k); });
  const splats = hasSplats(header);
  let grids = 0;
  levels.forEach((level, k) => {
    if (!header.front) directory(k);
    if (!splats) {
      const weights = ownShapes(header, level).reduce((sum, s) => sum + s.rows * s.columns, 0);
      want(Kind.networks, k, weights);
    }
    if (level.codebook_rows && level.codebook_columns && !(splats && level.inherits)) {
      want(Kind.codebook, k, level.codebook_rows);
    }
    for (let part = grids; part < level.grids; part++) want(Kind.grid, k, null, part);
    want(Kind.blocks, k, level.blocks);
    grids = level.grids;
  });
  return wants;
}

function checkChunks(index: Index): void {
  const wants = plan(index.header, index.levels);
  expectEqual(index.chunks.length, wants.length, "header: chunks");
  const shared = wants.findIndex(({ kind }) => kind !== Kind.manifest && kind !== Kind.directory);
  let offset = index.length;
  let raw = 0;
  let resolution = layout.RESOLUTION_MIN - 1;
  index.chunks.forEach((chunk, i) => {
    const want = must(wants[i], `chunk ${i}`);
    const where = `chunk ${i}`;
    checkRanges(chunk, layout.CHUNK, where);
    for (const name of ["kind", "level", "part"] as const) expectEqual(chunk[name], want[name], `${where}: ${name}`);
    if (want.rows !== null) expectEqual(chunk.rows, want.rows, `${where}: rows`);
    expectEqual(chunk.offset, offset, `${where}: offset`);
    checkSizes(index, chunk, where);
    if (chunk.kind !== Kind.grid) expectEqual(chunk.resolution, 0, `${where}: resolution`);
    else if (chunk.resolution <= resolution) {
      throw mismatch("LayoutError", `${where}: resolution`, chunk.resolution, `over ${resolution}`);
    } else resolution = chunk.resolution;
    if (i === shared) expectEqual(index.header.head, offset, "header: head");
    offset += chunk.stored;
    raw += chunk.raw;
    if (chunk.kind === Kind.blocks) checkLevelEnd(index, chunk.level, offset, raw);
  });
}

function checkSizes(index: Index, chunk: ChunkEntry, where: string): void {
  const { kind, raw, stored } = chunk;
  const coded = kind === Kind.networks || kind === Kind.codebook || kind === Kind.grid;
  if (!coded) expectEqual(chunk.coding, 0, `${where}: coding`);
  if (kind !== Kind.blocks) expectEqual(raw, rawLength(index, chunk), `${where}: raw`);
  else expectEqual(chunk.crc, 0, `${where}: crc`);
  if (stored > raw || (!stored && raw)) {
    throw mismatch("LayoutError", `${where}: stored`, stored, `1 to ${raw}`);
  }
  if (kind === Kind.manifest && raw > layout.MANIFEST_BYTES_MAX) {
    throw mismatch("LayoutError", `${where}: raw`, raw, `at most ${layout.MANIFEST_BYTES_MAX}`);
  }
}

function rawLength(index: Index, chunk: ChunkEntry): number {
  switch (chunk.kind) {
    case Kind.manifest:
      return chunk.rows;
    case Kind.directory:
      return chunk.rows * (directoryRecordBytes(chunk.level) + (hasPages(index.header) ? PAGE_MORE : 0));
    case Kind.networks:
      return ownShapes(index.header, index.levels[chunk.level]).reduce(
        (sum, s) => sum + valuesBytes(chunk.coding, s.rows * s.columns, 1),
        0,
      );
    default:
      return valuesBytes(chunk.coding, chunk.rows, columnsOf(index, chunk));
  }
}

/** Length of a directory's record: the fixed part, then rows new at level 0 … `level`. */
export function directoryRecordBytes(level: number): number {
  return layout.BLOCK_SIZE + 4 * (level + 1);
}

/** Values per row of a codebook or grid. */
export function columnsOf(index: Index, chunk: ChunkEntry): number {
  if (chunk.kind === Kind.codebook) return index.levels[chunk.level].codebook_columns;
  return index.header.features;
}

function checkLevelEnd(index: Index, number: number, end: number, raw: number): void {
  const level = index.levels[number];
  expectEqual(level.end, end, `level ${number}: end`);
  const limits = [
    ["raw", raw, layout.RAW_BYTES_BASE + layout.EXPANSION_MAX * end],
    ["slots", level.anchors * index.header.slots, layout.SLOTS_BASE + layout.EXPANSION_MAX * end],
    ["values", level.anchors * valuesPerAnchor(index.header, level), layout.VALUES_BASE + layout.VALUES_EXPANSION_MAX * end],
  ] as const;
  for (const [name, found, most] of limits) {
    if (found > most) throw mismatch("LayoutError", `level ${number}: ${name}`, found, `at most ${most}`);
  }
}
