/** The choice of what to fetch after the coarsest level, what to evict for it, and who unpacks it. */

import type { ViewPose } from "../base/view-pose";
import type { Assembler } from "../format/assembler";
import { blockPieces, isBlock, isShared, keyOf, pieceOf } from "../format/chunks";
import type { Piece } from "../format/chunks";
import { SHARED } from "../format/directory";
import type { BlockRecord } from "../format/directory";
import { Kind } from "../format/layout.gen";
import { FIRST_PAGE } from "../format/page-table";
import { ViewPrediction } from "../policy/prediction";
import type { Download, TakePiece } from "./download";
import { Residency, dropBlock } from "./residency";
import type { FetchedBlock, TableWriter } from "./table-writer";
import { poolFor } from "./unpack-pool";
import type { UnpackPool } from "./unpack-pool";

/** Requests in flight at once. */
const CONNECTIONS = 2;
/** Milliseconds until rows hold other splats: what was there has faded out. */
const FADED = 600;
/** Blocks under way in place of others at once. */
const SWAPS = 16;

/** Directories and page tables that stand at the beginning of their levels; all pages where what is held changes. */
export async function loadDirectories(assembler: Assembler, download: Download, writer: TableWriter, levels: number): Promise<void> {
  const { index, directories } = assembler;
  const take: TakePiece = (piece, bytes, following) => writer.takeChunk(piece, bytes, following);
  for (const chunk of index.chunks) {
    if (chunk.kind !== Kind.directory || directories.length > chunk.level) continue;
    if (chunk.level < levels) await download.stream([pieceOf(chunk)], take);
  }
  if (!assembler.pages || assembler.room === Infinity) return;
  for (let level = 1; level < Math.min(levels, directories.length); level++) {
    for (const page of assembler.pages.pieces(level)) await download.stream([page], take);
  }
}

/** Limits on what to fetch; they change while it is fetched. */
export interface Demand {
  /** Finest level wanted. */
  readonly cap: number;
  readonly paused: boolean;
  /** Cores of the machine. */
  readonly cores: number;
  levelsInFile(): number;
}

export interface SchedulerEvents {
  /** A block was evicted from the tables. */
  dropped(level: number, record: BlockRecord): void;
  /** Nothing more is to be fetched that there are rows for. */
  rest(bytes: number): void;
}

export class BlockScheduler {
  private readonly prediction: ViewPrediction;
  private readonly pool: UnpackPool | null;
  /** Eviction for a scene larger than its budget; null for others. */
  private readonly residency: Residency | null;
  /** Pieces in the tables or under way, by key. */
  private readonly requested = new Set<string>();
  /** Bytes of all blocks that came, by key, so that an evicted block is not fetched again. */
  private readonly compressed = new Map<string, Uint8Array>();
  /** Blocks that are unpacked or wait for those before them. */
  private readonly queue: Promise<void>[] = [];
  /** Blocks whose parents are still under way, by parent. */
  private readonly orphans = new Map<string, FetchedBlock[]>();
  private wake: (() => void)[] = [];
  /** Pages of directories under way. */
  private pages = 0;
  /** Blocks and requests under way. */
  private busy = 0;
  private fail: (error: unknown) => void = () => undefined;

  constructor(
    private readonly assembler: Assembler,
    private readonly download: Download,
    private readonly writer: TableWriter,
    private readonly demand: Demand,
    private readonly events: SchedulerEvents,
  ) {
    this.prediction = new ViewPrediction(assembler);
    this.pool = poolFor(assembler, demand.cap, demand.cores);
    this.residency = assembler.room < Infinity ? new Residency(assembler) : null;
  }

  /** Workers that unpack blocks. */
  get workers(): number {
    return this.pool?.workers ?? 1;
  }

  /** Ends with an error only. */
  async run(): Promise<void> {
    const failed = new Promise<never>((_, reject) => { this.fail = reject; });
    await Promise.all([failed, ...Array.from({ length: CONNECTIONS }, () => this.fetchForever())]);
  }

  look(view: ViewPose): void {
    this.prediction.look(view, performance.now() / 1000);
    if (this.residency) this.poke();
  }

  /** Something changed that may give work. */
  poke(): void {
    for (const wake of this.wake.splice(0)) wake();
  }

  /** Let a block be unpacked while more bytes come; blocks are placed in the order in which they came. */
  private async handOut(piece: Piece, bytes: Uint8Array): Promise<void> {
    const { queue, pool } = this;
    if (this.residency) this.compressed.set(keyOf(piece), bytes);
    const unpacked = pool?.unpack(this.assembler.packed(piece.level, piece.block, bytes));
    // Its turn comes to be awaited.
    unpacked?.catch(() => undefined);
    const placed = Promise.resolve(queue.at(-1)).then(async () => {
      await this.placeBlock({ piece, bytes, unpacked });
      void queue.shift();
      if (this.residency) this.poke();
    });
    placed.catch(this.fail);
    queue.push(placed);
    const most = pool?.most ?? 0;
    while (queue.length > most) await queue[0];
  }

  /** Put a block into the tables, and those that waited for it. */
  private async placeBlock(fetched: FetchedBlock): Promise<void> {
    const { level, block } = fetched.piece;
    const { parent } = this.assembler.directories[level][block];
    if (!this.assembler.hasBlock(level - 1, parent)) {
      const name = `${level - 1}/${parent}`;
      this.orphans.set(name, [...(this.orphans.get(name) ?? []), fetched]);
      return;
    }
    await this.writer.takeBlock(fetched);
    const name = `${level}/${block}`;
    const waiting = this.orphans.get(name) ?? [];
    this.orphans.delete(name);
    for (const child of waiting) await this.placeBlock(child);
  }

  /** One connection: fetch what is chosen, or wait until there is a choice. */
  private async fetchForever(): Promise<never> {
    for (;;) {
      const pieces = this.demand.paused ? null : this.choose();
      if (pieces) {
        await this.fetch(pieces);
        this.poke();
        continue;
      }
      if (this.residency && !this.demand.paused && !this.busy && !this.queue.length) this.events.rest(this.download.bytes);
      await new Promise<void>((resolve) => this.wake.push(resolve));
    }
  }

  private async fetch(pieces: readonly Piece[]): Promise<void> {
    // Each stays under way until it is in the tables, and then is held.
    for (const piece of pieces) this.requested.add(keyOf(piece));
    this.busy++;
    const page = pieces[0].more !== undefined;
    if (page) this.pages++;
    const kept = this.compressed.get(keyOf(pieces[0]));
    const take: TakePiece = (piece, bytes, following) =>
      isBlock(piece) ? this.handOut(piece, bytes) : this.writer.takeChunk(piece, bytes, following);
    await (kept ? this.handOut(pieces[0], kept) : this.download.stream(pieces, take));
    if (page) {
      this.pages--;
      this.prediction.learn();
    }
    this.busy--;
  }

  /** Blocks and shared parts of levels, side by side: what the policy asks for next. */
  private choose(): Piece[] | null {
    const { demand, assembler } = this;
    const { directories } = assembler;
    const levels = Math.min(demand.cap + 1, directories.length, demand.levelsInFile());
    if (this.residency) return this.chooseWithin(this.residency, levels);
    const received = assembler.pages ? [] : this.chooseReceived(levels);
    if (received.length) return received;
    // Pages come one at a time before blocks: what is chosen next is then chosen among more of what there is to see.
    const page = this.pages ? null : this.choosePage(levels, false);
    if (page) return page;
    const run = this.prediction.next(levels, this.download, (level, block) => this.isKnown(level, block));
    const pieces = run.flatMap(({ level, block }) => (block === SHARED
      ? this.sharedPieces(level).filter((piece) => !this.requested.has(keyOf(piece)))
      : blockPieces(level, [directories[level][block]], block)));
    return pieces.length ? pieces : this.choosePage(levels, true);
  }

  /** The page of a directory that is wanted, if there is one. */
  private choosePage(levels: number, all: boolean): Piece[] | null {
    const { pages } = this.assembler;
    const found = this.prediction.page(levels, all, (level, page) => this.requested.has(`${level}/${FIRST_PAGE - page}`));
    return found && [pages!.piece(...found)];
  }

  /** Pieces of these levels within the first request: no policy can save their bytes. */
  private chooseReceived(levels: number): Piece[] {
    const { index, directories } = this.assembler;
    const { stop } = this.download.reader;
    const here: Piece[] = [];
    for (let level = 1; level < levels && index.levels[level - 1].end < stop; level++) {
      for (const piece of [...this.sharedPieces(level), ...blockPieces(level, directories[level])]) {
        const known = this.requested.has(keyOf(piece));
        const goesOn = !here.length || (!known && here[here.length - 1].stop === piece.start);
        if (!goesOn || piece.stop > stop) return here;
        if (!known) here.push(piece);
      }
    }
    return here;
  }

  /** The block that the pictures need most and that has room, if need be in place of others. */
  private chooseWithin(residency: Residency, levels: number): Piece[] | null {
    const { assembler } = this;
    const { directories } = assembler;
    for (let level = 1; level < levels; level++) {
      const shared = this.sharedPieces(level).filter((piece) => !this.requested.has(keyOf(piece)));
      if (shared.length) return shared;
    }
    const worth = this.prediction.worth();
    while (this.busy < SWAPS) {
      const found = residency.next(worth, levels, (number) => assembler.hasBlock(worth.items[number].level, worth.items[number].block));
      if (!found) return null;
      const { level, block } = worth.items[found.number];
      const pieces = blockPieces(level, [directories[level][block]], block);
      if (!found.lost.length) return pieces;
      for (const number of found.lost) this.drop(worth.items[number].level, worth.items[number].block);
      this.busy++;
      this.requested.add(keyOf(pieces[0]));
      setTimeout(() => {
        this.busy--;
        this.fetch(pieces).then(() => { this.poke(); }, this.fail);
      }, FADED);
    }
    return null;
  }

  private drop(level: number, block: number): void {
    dropBlock(this.assembler, level, block);
    this.requested.delete(`${level}/${block}`);
    this.events.dropped(level, this.assembler.directories[level][block]);
  }

  /** True if a block, or the shared part of a level, is in the tables or under way. */
  private isKnown(level: number, block: number): boolean {
    if (level === 0) return true;
    if (block === SHARED) return this.sharedPieces(level).every((piece) => this.requested.has(keyOf(piece)));
    return this.requested.has(`${level}/${block}`);
  }

  private sharedPieces(level: number): Piece[] {
    return this.assembler.index.chunks.filter((chunk) => chunk.level === level && isShared(chunk)).map((chunk) => pieceOf(chunk));
  }
}
