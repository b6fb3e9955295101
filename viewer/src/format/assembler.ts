/** The decoded part of a file, growing chunk by chunk and block by block. */

import { unpackBlock } from "./block";
import type { Block, Packed, Values } from "./block";
import { rawBytes } from "./codecs";
import { maskBits, parseDirectory, spanOf } from "./directory";
import type { BlockRecord } from "./directory";
import { ViewerError } from "../base/errors";
import { codesOf, columnsOf, hasPages, hasSplats, hasSteps, nameOf, ownShapes, ownerOf, parseIndex, scalesOf } from "./file-index";
import type { ChunkEntry, Index, LevelEntry, WeightShape } from "./file-index";
import { freeMemory } from "../base/free-memory";
import { LazyModule } from "../base/lazy-module";
import { blockPieces } from "./chunks";
import type { Piece } from "./chunks";
import { Kind } from "./layout.gen";
import { parseManifest } from "./manifest";
import type { Manifest } from "./manifest";
import type * as pageTable from "./page-table";
import { decodeValues, valuesBytes } from "./values";

/** The reader of directories in pages, which few files have. */
export const pageTableModule = new LazyModule<typeof pageTable>();

export type Networks = ReadonlyMap<string, Float32Array>;

/** In `region`: no block that holds the anchor is there. */
export const NOWHERE = 255;
const END = -1;

/** Anchors and live slots of all blocks held, by their numbers in the whole file. */
export type Tables = {
  readonly lattice: Int32Array; // [n, 3]
  readonly logScales: Values; // [n, 6], of splats [n, 3]
  readonly codes: Uint8Array; // [n], 0 without a codebook; of splats [n, `stages`]
  readonly residual: Values; // [n, R]
  /** Number of the block that brought a splat, among those of all levels. */
  readonly block: Uint32Array; // of splats [n], else [0]
  /** Finest level at which a block with the anchor is held, or `NOWHERE`. */
  readonly region: Uint8Array; // [n]
  /** The level that brings each slot. */
  readonly brought: Uint8Array; // [m]
  /** The anchor's newest live slot, or -1; `next` leads on. */
  readonly head: Int32Array; // [n], of splats [0]
  /** Live slots, by level of becoming live, then block: those of level k are the first live_k. */
  readonly slot: Uint8Array; // [m], of splats [0]
  readonly offsets: Float32Array; // [m, 3], of splats [0]
  readonly next: Int32Array; // [m], of splats [0]
  readonly owner: Int32Array; // [m] its anchor, or -1; of splats [0], since each is its own
};

/** A client's state: the index, then chunks and blocks in any order their parents allow. */
export class Assembler {
  readonly index: Index;
  readonly directories: BlockRecord[][] = [];
  readonly networks = new Map<number, Networks>();
  readonly codebooks = new Map<number, Float32Array>();
  readonly grids = new Map<number, Float32Array>();
  manifest: Manifest | null = null;
  /** Directories in pages; `directories` is empty where pages have not come. Null for plain directories. */
  pages: pageTable.PageTables | null = null;
  tables: Tables;
  /** Codes of each row of the tables: the most that a level has. */
  readonly stages: number;
  /** Rows of the tables for slots at most: a file's own numbers hold for those of level 0 alone then, see `Residency`. */
  room = Infinity;
  readonly held: Set<number>[];
  /** `Block.affine` by `Tables.block`. */
  readonly affine: Float32Array[] = [];

  /** Start from the first bytes of a file, at least header and tables. */
  constructor(head: Uint8Array) {
    this.index = parseIndex(head);
    this.held = this.index.levels.map(() => new Set());
    this.stages = Math.max(1, ...this.index.levels.map((_, k) => codesOf(this.index, k)));
    this.tables = this.emptyTables(0, 0);
  }

  /** Number of complete levels, from the coarsest on. */
  get levelsReady(): number {
    const { levels } = this.index;
    let k = 0;
    while (k < levels.length && this.hasShared(k) && this.held[k].size === levels[k].blocks) k++;
    return k;
  }

  /** True once networks, codebook and grids of a level are there; with splats the codebook. */
  hasShared(level: number): boolean {
    const entry = this.index.levels[level];
    if (hasSplats(this.index.header)) return !entry.codebook_rows || this.codebooks.has(ownerOf(this.index, level));
    if (!this.networks.has(level) || !this.networks.has(ownerOf(this.index, level))) return false;
    if (entry.codebook_rows * entry.codebook_columns && !this.codebooks.has(level)) return false;
    for (let part = 0; part < entry.grids; part++) if (!this.grids.has(part)) return false;
    return true;
  }

  /** Rows of anchors and of slots in which blocks up to a level stand, as far as there are any. */
  rowsUpTo(level: number): Pick<LevelEntry, "anchors" | "live"> {
    const { room, tables: { region, brought }, index, held } = this;
    const finest = held.reduce((found, { size }, k) => (size ? k : found), 0);
    const { anchors, live } = room < Infinity ? { anchors: room, live: room } : index.levels[Math.min(level, finest)];
    return { anchors: Math.min(anchors, region.length), live: Math.min(live, brought.length) };
  }

  hasBlock(level: number, block: number): boolean {
    return this.held[level].has(block);
  }

  /** All blocks of a level to fetch; in pages those pages. */
  piecesOf(level: number): Piece[] {
    return this.pages?.pieces(level) ?? blockPieces(level, this.directories[level]);
  }

  /** Take the bytes of a chunk of the index, other than blocks. */
  async add(chunk: ChunkEntry, stored: Uint8Array): Promise<void> {
    const where = nameOf(chunk);
    const level = chunk.level;
    if (chunk.kind === Kind.directory) {
      if (hasPages(this.index.header)) {
        const { PageTables } = await pageTableModule.get();
        this.pages ??= new PageTables(this.index, this.directories);
        return this.pages.addTable(chunk, stored);
      }
      const parent = level ? this.directories[level - 1] : undefined;
      this.directories[level] = await parseDirectory(this.index, chunk, stored, parent);
      return;
    }
    const raw = await rawBytes(stored, spanOf(chunk), where);
    const columns = columnsOf(this.index, chunk);
    switch (chunk.kind) {
      case Kind.manifest:
        this.manifest = parseManifest(raw, this.index.levels.length);
        break;
      case Kind.networks:
        this.networks.set(level, this.decodeNetworks(chunk, raw, where));
        break;
      case Kind.codebook:
        this.codebooks.set(level, decodeValues(chunk.coding, raw, chunk.rows, columns, where));
        break;
      case Kind.grid:
        this.grids.set(chunk.part, decodeValues(chunk.coding, raw, chunk.rows, columns, where));
        break;
    }
  }

  /** The bytes of a block with what is known of it. */
  packed(level: number, number: number, stored: Uint8Array): Packed {
    return { level, record: this.directories[level][number], stored, where: `level ${level} block ${number}` };
  }

  /** Take the bytes of a block, whose directory and parent block are there; or its values, unpacked elsewhere. */
  async addBlock(level: number, number: number, stored: Uint8Array, unpacked?: Promise<Block>): Promise<void> {
    const packed = this.packed(level, number, stored);
    const { record, where } = packed;
    if (level && !this.hasBlock(level - 1, record.parent)) {
      throw new ViewerError("LayoutError", `${where}: comes before its parent`);
    }
    const block = await (unpacked ?? unpackBlock(packed, this.index));
    // Where there is less room than for all, `Residency` has made it.
    if (!level || this.room === Infinity) this.reserve(this.index.levels[level]);
    if (hasSplats(this.index.header)) this.placeSplats(level, number, record, block);
    else this.place(level, record, block, where);
    freeMemory(...Object.values(block));
    this.held[level].add(number);
  }

  /** Rows of the slots that a block brings: the first, and how many. */
  slotsOf(level: number, record: BlockRecord): readonly [number, number] {
    const before = level && this.room === Infinity ? this.index.levels[level - 1].live : 0;
    return [hasSplats(this.index.header) ? record.starts[level] : before + record.firstSlot, record.live - record.before];
  }

  /** Numbers of a block's anchors as ranges [first, count], those of coarser levels first. */
  static rangesOf(record: BlockRecord): [number, number][] {
    return record.starts.map((start, k) => [start, record.rows[k]]);
  }

  private decodeNetworks(chunk: ChunkEntry, raw: Uint8Array, where: string): Networks {
    const weights = new Map<string, Float32Array>();
    let at = 0;
    for (const { name, rows, columns } of this.shapes(chunk.level)) {
      const length = valuesBytes(chunk.coding, rows * columns, 1);
      const part = raw.subarray(at, (at += length));
      weights.set(name, decodeValues(chunk.coding, part, rows * columns, 1, where));
    }
    return weights;
  }

  private shapes(level: number): WeightShape[] {
    return ownShapes(this.index.header, this.index.levels[level]);
  }

  /** Room for so many anchors and slots. */
  reserve({ anchors, live }: Pick<LevelEntry, "anchors" | "live">): void {
    if (this.tables.region.length >= anchors && this.tables.brought.length >= live) return;
    const tables = this.emptyTables(anchors, live);
    const columns = tables as unknown as Record<string, Float32Array>;
    for (const [name, before] of Object.entries(this.tables as unknown as Record<string, Float32Array>)) {
      columns[name].set(before);
      freeMemory(before);
    }
    this.tables = tables;
  }

  /** Put a block's new splats into the tables: each is a slot, which has its number. */
  private placeSplats(level: number, number: number, record: BlockRecord, block: Block): void {
    const { tables, stages, index: { header, levels }, affine } = this;
    const first = record.starts[level];
    const count = record.rows[level];
    const codes = codesOf(this.index, level);
    tables.lattice.set(block.lattice, 3 * first);
    tables.logScales.set(block.logScales, 3 * first);
    tables.residual.set(block.residual, header.residual * first);
    const id = levels.slice(0, level).reduce((sum, { blocks }) => sum + blocks, number);
    affine[id] = block.affine.slice();
    tables.block.fill(id, first, first + count);
    tables.brought.fill(level, first, first + count);
    for (let i = 0; codes && i < count; i++) {
      tables.codes.set(block.codes.subarray(i * codes, (i + 1) * codes), (first + i) * stages);
    }
    for (const [start, rows] of Assembler.rangesOf(record)) tables.region.fill(level, start, start + rows);
  }

  /** Put a block's anchors and new live slots into the tables, or throw and leave them. */
  private place(level: number, record: BlockRecord, block: Block, where: string): void {
    const { tables, index } = this;
    const slots = index.header.slots;
    const fresh = record.starts[level];
    const [firstRow] = this.slotsOf(level, record);
    const owners = new Int32Array(block.offsets.length / 3);
    const chosen = new Uint8Array(owners.length);
    const live = new Uint8Array(slots);
    let bit = 0;
    let row = 0;
    for (const [first, count] of Assembler.rangesOf(record)) {
      const old = first !== fresh;
      for (let anchor = first; anchor < first + count; anchor++) {
        live.fill(0);
        if (old) for (let r = tables.head[anchor]; r !== END; r = tables.next[r]) live[tables.slot[r]] = 1;
        let any = old;
        for (let slot = 0; slot < slots; slot++) {
          if (live[slot]) continue;
          if ((block.mask[bit >> 3] >> (bit & 7)) & 1) {
            owners[row] = anchor;
            chosen[row++] = slot;
            any = true;
          }
          bit++;
        }
        if (!any) throw new ViewerError("LayoutError", `${where}: anchor ${anchor} without a live slot`);
      }
    }
    if (bit !== maskBits(index, record)) {
      throw new ViewerError("LayoutError", `${where}: other live slots at level ${level - 1} than in its record`);
    }
    tables.lattice.set(block.lattice, 3 * fresh);
    tables.logScales.set(block.logScales, 6 * fresh);
    tables.codes.set(block.codes, fresh);
    tables.residual.set(block.residual, index.header.residual * fresh);
    tables.offsets.set(block.offsets, 3 * firstRow);
    tables.slot.set(chosen, firstRow);
    tables.owner.set(owners, firstRow);
    tables.brought.fill(level, firstRow, firstRow + owners.length);
    owners.forEach((anchor, i) => {
      tables.next[firstRow + i] = tables.head[anchor];
      tables.head[anchor] = firstRow + i;
    });
    for (const [first, count] of Assembler.rangesOf(record)) {
      tables.region.fill(level, first, first + count);
    }
  }

  private emptyTables(anchors: number, live: number): Tables {
    const { header } = this.index;
    const splats = hasSplats(header);
    const [heads, slots] = splats ? [0, 0] : [anchors, live];
    const Column = hasSteps(this.index) ? Uint16Array : Float32Array;
    return {
      lattice: new Int32Array(3 * anchors),
      logScales: new Column(scalesOf(header) * anchors),
      codes: new Uint8Array(this.stages * anchors),
      residual: new Column(header.residual * anchors),
      block: new Uint32Array(splats ? anchors : 0),
      region: new Uint8Array(anchors).fill(NOWHERE),
      brought: new Uint8Array(live),
      head: new Int32Array(heads).fill(END),
      slot: new Uint8Array(slots),
      offsets: new Float32Array(3 * slots),
      next: new Int32Array(slots).fill(END),
      owner: new Int32Array(slots).fill(END),
    };
  }
}
