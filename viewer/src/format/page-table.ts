/** Directories in pages: which blocks a page lists, and where each page stands; as container/pages.py. */

import { rawBytes } from "./codecs";
import { anchorsBefore, checkBlocks, checkParents, readBlocks, spanOf } from "./directory";
import type { BlockRecord, Place } from "./directory";
import { ViewerError, mismatch } from "../base/errors";
import { directoryRecordBytes, nameOf } from "./file-index";
import type { ChunkEntry, Index } from "./file-index";
import * as layout from "./layout.gen";
import { Kind } from "./layout.gen";
import { blockPieces } from "./chunks";
import type { Piece } from "./chunks";
import { checkRanges, expectEqual, readRecord } from "./records";
import type { Numbers } from "./records";

/** Block number of the first page of a level's directory; further pages count down from it. */
export const FIRST_PAGE = -2;

/** One page: its record, and what follows from those before it. */
interface PageRecord extends Numbers<typeof layout.PAGE> {
  readonly rows: readonly number[];
  /** File offset of the page; its blocks follow it. */
  readonly offset: number;
  /** Number of its first block, and of the first block that these divide. */
  readonly first: number;
  readonly firstParent: number;
  /** Running sums before its first block. */
  readonly place: Place;
}

export class PageTables {
  readonly tables: PageRecord[][] = [];
  private readonly held: Set<number>[] = [];

  /** `directories`: those of the file, filled page by page. */
  constructor(
    private readonly index: Index,
    private readonly directories: BlockRecord[][],
  ) {}

  /** Take the bytes of a level's page table. */
  async addTable(chunk: ChunkEntry, stored: Uint8Array): Promise<void> {
    const { index, directories } = this;
    const { level } = chunk;
    const parents = level ? (this.tables[level - 1] as PageRecord[] | undefined) : null;
    if (parents === undefined) throw new ViewerError("LayoutError", `${nameOf(chunk)}: comes before its parent`);
    this.tables[level] = await parseTable(index, chunk, stored, parents);
    this.held[level] = new Set();
    directories[level] = new Array<BlockRecord>(index.levels[level].blocks);
  }

  hasPage(level: number, page: number): boolean {
    return this.held[level].has(page);
  }

  /** The page that lists the blocks into which one of the level before is divided. */
  pageUnder(level: number, parent: number): number {
    const table = this.tables[level];
    let [low, high] = [0, table.length];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (table[middle].firstParent <= parent) low = middle;
      else high = middle;
    }
    return low;
  }

  /** Take the bytes of a page, whose table and the page of the level before are there. */
  async addPage(level: number, page: number, stored: Uint8Array): Promise<BlockRecord[]> {
    const { index, directories } = this;
    const record = this.tables[level][page];
    const where = `level ${level} page ${page}`;
    if (level && !this.hasPage(level - 1, record.parent)) throw new ViewerError("LayoutError", `${where}: comes before its parent`);
    const span = { stored: record.stored, raw: record.blocks * directoryRecordBytes(level), crc: record.crc };
    const raw = await rawBytes(stored, span, where);
    const records = readBlocks(raw, level, record.blocks, record.place, where);
    const { body, raw: inflated, live, before } = record;
    checkSums<"stored" | "raw" | "live" | "before">(records, { stored: body, raw: inflated, live, before }, record.rows, where);
    checkBlocks(index, level, records, where);
    records.forEach((block, b) => {
      const inside = block.reach <= record.reach && (["x", "y", "z"] as const).every((axis) =>
        block[`low_${axis}`] >= record[`low_${axis}`] && block[`high_${axis}`] <= record[`high_${axis}`]);
      if (!inside && block.rows.some((n) => n)) throw new ViewerError("ValueRangeError", `${where}: block ${b}: its box is not within its page's`);
    });
    if (level) {
      const { firstParent, parents } = record;
      checkParents(level, records, directories[level - 1].slice(firstParent, firstParent + parents), where, firstParent);
    }
    records.forEach((block, b) => { directories[level][record.first + b] = block; });
    this.held[level].add(page);
    return records;
  }

  /** The bytes of a page; of the base its blocks follow it. */
  piece(level: number, page: number): Piece {
    const { offset, stored, first } = this.tables[level][page];
    const more = async (bytes: Uint8Array) => {
      const records = await this.addPage(level, page, bytes);
      return level ? [] : blockPieces(0, records, first);
    };
    return { start: offset, stop: offset + stored, chunk: null, level, block: FIRST_PAGE - page, more };
  }

  /** All pages of a level, and where it ends. */
  pieces(level: number): Piece[] {
    const { end } = this.index.levels[level];
    const last = { start: end, stop: end, chunk: null, level, block: FIRST_PAGE - this.tables[level].length, more: () => Promise.resolve([]) };
    return [...this.tables[level].map((_, page) => this.piece(level, page)), last];
  }
}

/** Fields, and the anchors that each level brings, sum up to what is known of all records together. */
function checkSums<K extends string>(
  records: readonly (Record<K, number> & Pick<BlockRecord, "rows">)[],
  sums: Record<K, number>,
  rows: readonly number[],
  where: string,
): void {
  const names = Object.keys(sums) as K[];
  for (const name of names) expectEqual(records.reduce((sum, record) => sum + record[name], 0), sums[name], `${where}: ${name}`);
  rows.forEach((expected, k) => { expectEqual(records.reduce((sum, record) => sum + record.rows[k], 0), expected, `${where}: rows ${k}`); });
}

async function parseTable(index: Index, chunk: ChunkEntry, stored: Uint8Array, parents: readonly PageRecord[] | null): Promise<PageRecord[]> {
  const where = nameOf(chunk);
  const { level, rows: count } = chunk;
  const raw = await rawBytes(stored, spanOf(chunk), where);
  const size = layout.PAGE_SIZE + 4 * (level + 1);
  const bytes = new Uint8Array(size);
  const view = new DataView(bytes.buffer);
  const blocks = index.chunks.find((c) => c.level === level && c.kind === Kind.blocks)!;
  let offset = blocks.offset;
  let [first, firstParent, firstSlot] = [0, 0, 0];
  const starts = index.levels.slice(0, level + 1).map((_, k) => anchorsBefore(index, k));
  const table: PageRecord[] = [];
  for (let page = 0; page < count; page++) {
    for (let i = 0; i < size; i++) bytes[i] = raw[i * count + page];
    const entry = readRecord(view, 0, layout.PAGE);
    checkRanges(entry, layout.PAGE, `${where}: page ${page}`);
    const rows = starts.map((_, k) => view.getUint32(layout.PAGE_SIZE + 4 * k, true));
    const place = { starts: starts.slice(), offset: offset + entry.stored, firstSlot };
    table.push({ ...entry, rows, offset, first, firstParent, place });
    rows.forEach((n, k) => (starts[k] += n));
    offset += entry.stored + entry.body;
    first += entry.blocks;
    firstParent += entry.parents;
    firstSlot += entry.live - entry.before;
  }
  const before = level ? index.levels[level - 1] : { blocks: 0, live: 0 };
  const own = index.levels[level];
  const body = blocks.stored - table.reduce((sum, page) => sum + page.stored, 0);
  const rawBody = blocks.raw - own.blocks * directoryRecordBytes(level);
  const sums = { blocks: own.blocks, parents: before.blocks, live: own.live, before: before.live, body, raw: rawBody };
  const brought = index.levels.slice(0, level + 1).map(({ anchors }, k) => anchors - anchorsBefore(index, k));
  checkSums<keyof typeof sums>(table, sums, brought, where);
  table.forEach((page, p) => { checkPage(index, level, page, `${where}: page ${p}`); });
  if (parents) {
    checkParents(level, table, parents, where);
    parents.forEach((page, p) => {
      const found = table.reduce((sum, { parent, parents: n }) => sum + (parent === p ? n : 0), 0);
      if (found !== page.blocks) throw mismatch("LayoutError", `${where}: parents`, found, page.blocks);
    });
  }
  return table;
}

function checkPage(index: Index, level: number, page: PageRecord, where: string): void {
  const { slots } = index.header;
  const total = page.rows.reduce((sum, n) => sum + n, 0);
  const fresh = page.rows[level];
  const least = Number(level > 0);
  const rules: [string, boolean][] = [
    ["stored", page.stored <= page.blocks * directoryRecordBytes(level)],
    ["parent", level > 0 || page.parent === 0],
    ["parents", page.parents >= least && page.parents <= page.blocks * least],
    ["live", page.live >= page.before + fresh && page.live <= total * slots],
    ["before", page.before >= total - fresh && page.before <= (total - fresh) * slots],
    ["body", page.body <= page.raw],
    ["low_x", page.low_x <= page.high_x],
    ["low_y", page.low_y <= page.high_y],
    ["low_z", page.low_z <= page.high_z],
  ];
  for (const [name, good] of rules) {
    if (!good) throw new ViewerError("LayoutError", `${where}: ${name} does not fit its counts`);
  }
}
