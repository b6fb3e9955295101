/** What of a scene is fetched after its base, what of it is dropped, and who unpacks it. */

import type { Assembler } from "../format/assembler";
import { Bounded, drop, forget } from "./residency";
import { SHARED } from "../format/directory";
import { Foresight } from "../policy/prediction";
import type { Came, Loader } from "./base-loader";
import type { Eye } from "../decode/messages";
import { Kind } from "../format/layout.gen";
import { PAGES } from "../format/page-table";
import { blockPieces, isShared, keyOf, pieceOf } from "../format/chunks";
import type { Piece } from "../format/chunks";
import { poolFor } from "./unpack-pool";
import type { Pool } from "./unpack-pool";

/** Requests at once. */
const LANES = 2;
/** Milliseconds until rows hold other splats: what was there has faded out. */
const FADED = 600;
/** Blocks under way in place of others at once. */
const SWAPS = 16;

/** Directories and page tables that stand at the beginning of their levels; all pages where what is held changes. */
export async function loadDirectories(loader: Loader, assembler: Assembler): Promise<void> {
  const { index, directories } = assembler;
  const levels = loader.levelsInFile();
  for (const chunk of index.chunks) {
    if (chunk.kind !== Kind.directory || directories.length > chunk.level) continue;
    if (chunk.level < levels) await loader.stream([pieceOf(chunk)]);
  }
  if (!assembler.pages || assembler.room === Infinity) return;
  for (let level = 1; level < Math.min(levels, directories.length); level++) {
    for (const page of assembler.pages.pieces(level)) await loader.stream([page]);
  }
}

export class Lanes {
  private readonly foresight: Foresight;
  private readonly pool: Pool | null;
  private readonly bounded: Bounded | null;
  /** Pieces that are held or under way. */
  private readonly asked = new Set<string>();
  /** Of blocks that were held, so that they are read once. */
  private readonly kept = new Map<string, Uint8Array>();
  /** Of blocks that are unpacked or wait for those before them. */
  private readonly turns: Promise<void>[] = [];
  /** Blocks whose parents are still under way, by parent. */
  private readonly early = new Map<string, Came[]>();
  private wake: (() => void)[] = [];
  /** Pages of directories under way. */
  private pages = 0;
  /** Blocks and requests under way. */
  private busy = 0;
  private refuse: (error: unknown) => void = () => undefined;

  constructor(
    private readonly loader: Loader,
    private readonly assembler: Assembler,
  ) {
    this.foresight = new Foresight(assembler);
    this.pool = poolFor(assembler, loader.cap, loader.cores);
    this.bounded = assembler.room < Infinity ? new Bounded(assembler) : null;
  }

  /** Workers that unpack blocks. */
  get workers(): number {
    return this.pool?.workers ?? 1;
  }

  /** Ends with an error only. */
  async run(): Promise<void> {
    const refused = new Promise<never>((_, reject) => { this.refuse = reject; });
    await Promise.all([refused, ...Array.from({ length: LANES }, () => this.lane())]);
  }

  look(eye: Eye): void {
    this.foresight.look(eye, performance.now() / 1000);
    if (this.bounded) this.poke();
  }

  /** Something changed that may give work. */
  poke(): void {
    for (const wake of this.wake.splice(0)) wake();
  }

  /** Let a block be unpacked while more bytes come; blocks are placed in the order in which they came. */
  async handOut(piece: Piece, bytes: Uint8Array): Promise<void> {
    const { turns, pool } = this;
    if (this.bounded) this.kept.set(keyOf(piece), bytes);
    const unpacked = pool?.unpack(this.assembler.packed(piece.level, piece.block, bytes));
    // Its turn comes to be awaited.
    unpacked?.catch(() => undefined);
    const turn = Promise.resolve(turns.at(-1)).then(async () => {
      await this.take({ piece, bytes, unpacked });
      void turns.shift();
      if (this.bounded) this.poke();
    });
    turn.catch(this.refuse);
    turns.push(turn);
    const most = pool?.most ?? 0;
    while (turns.length > most) await turns[0];
  }

  /** Put a block into the tables, and those that waited for it. */
  private async take(came: Came): Promise<void> {
    const { level, block } = came.piece;
    const { parent } = this.assembler.directories[level][block];
    if (!this.assembler.hasBlock(level - 1, parent)) {
      const name = `${level - 1}/${parent}`;
      this.early.set(name, [...(this.early.get(name) ?? []), came]);
      return;
    }
    await this.loader.takeBlock(came);
    const name = `${level}/${block}`;
    const waiting = this.early.get(name) ?? [];
    this.early.delete(name);
    for (const child of waiting) await this.take(child);
  }

  private async lane(): Promise<never> {
    for (;;) {
      const pieces = this.loader.paused ? null : this.choose();
      if (pieces) {
        await this.fetch(pieces);
        this.poke();
        continue;
      }
      if (this.bounded && !this.loader.paused && !this.busy && !this.turns.length) this.loader.events.rest(this.loader.bytes);
      await new Promise<void>((resolve) => this.wake.push(resolve));
    }
  }

  private async fetch(pieces: readonly Piece[]): Promise<void> {
    // Each stays under way until it is in the tables, and then is held.
    for (const piece of pieces) this.asked.add(keyOf(piece));
    this.busy++;
    const page = pieces[0].more !== undefined;
    if (page) this.pages++;
    const kept = this.kept.get(keyOf(pieces[0]));
    await (kept ? this.handOut(pieces[0], kept) : this.loader.stream(pieces));
    if (page) {
      this.pages--;
      this.foresight.learn();
    }
    this.busy--;
  }

  /** Blocks and shared parts of levels, side by side: what the policy asks for next. */
  private choose(): Piece[] | null {
    const { loader, assembler } = this;
    const { directories } = assembler;
    const levels = Math.min(loader.cap + 1, directories.length, loader.levelsInFile());
    if (this.bounded) return this.chooseWithin(this.bounded, levels);
    const here = assembler.pages ? [] : this.chooseHere(levels);
    if (here.length) return here;
    // Pages come one at a time before blocks: what is chosen next is then chosen among more of what there is to see.
    const page = this.pages ? null : this.choosePage(levels, false);
    if (page) return page;
    const run = this.foresight.next(levels, loader.samples, (level, block) => this.isKnown(level, block));
    const pieces = run.flatMap(({ level, block }) => (block === SHARED
      ? this.sharedPieces(level).filter((piece) => !this.asked.has(keyOf(piece)))
      : blockPieces(level, [directories[level][block]], block)));
    return pieces.length ? pieces : this.choosePage(levels, true);
  }

  /** The page of a directory that is wanted, if there is one. */
  private choosePage(levels: number, all: boolean): Piece[] | null {
    const { pages } = this.assembler;
    const found = this.foresight.page(levels, all, (level, page) => this.asked.has(`${level}/${PAGES - page}`));
    return found && [pages!.piece(...found)];
  }

  /** What the first request has brought of these levels, or will: no policy can save its bytes. */
  private chooseHere(levels: number): Piece[] {
    const { index, directories } = this.assembler;
    const { stop } = this.loader;
    const here: Piece[] = [];
    for (let level = 1; level < levels && index.levels[level - 1].end < stop; level++) {
      for (const piece of [...this.sharedPieces(level), ...blockPieces(level, directories[level])]) {
        const known = this.asked.has(keyOf(piece));
        const goesOn = !here.length || (!known && here[here.length - 1].stop === piece.start);
        if (!goesOn || piece.stop > stop) return here;
        if (!known) here.push(piece);
      }
    }
    return here;
  }

  /** The block that the pictures need most and that has room, if need be in place of others. */
  private chooseWithin(bounded: Bounded, levels: number): Piece[] | null {
    const { assembler } = this;
    const { directories } = assembler;
    for (let level = 1; level < levels; level++) {
      const shared = this.sharedPieces(level).filter((piece) => !this.asked.has(keyOf(piece)));
      if (shared.length) return shared;
    }
    const worth = this.foresight.worth();
    while (this.busy < SWAPS) {
      const found = bounded.next(worth, levels, (number) => assembler.hasBlock(worth.items[number].level, worth.items[number].block));
      if (!found) return null;
      const { level, block } = worth.items[found.number];
      const pieces = blockPieces(level, [directories[level][block]], block);
      if (!found.lost.length) return pieces;
      for (const number of found.lost) this.drop(worth.items[number].level, worth.items[number].block);
      this.busy++;
      this.asked.add(keyOf(pieces[0]));
      setTimeout(() => {
        this.busy--;
        this.fetch(pieces).then(() => { this.poke(); }, this.refuse);
      }, FADED);
    }
    return null;
  }

  private drop(level: number, block: number): void {
    const record = this.assembler.directories[level][block];
    drop(this.assembler, level, block, record);
    this.asked.delete(`${level}/${block}`);
    this.loader.events.dropped((look) => { forget(look, this.assembler, level, record); });
  }

  /** Whether a block, or what the blocks of a level share, is held or under way. */
  private isKnown(level: number, block: number): boolean {
    if (level === 0) return true;
    if (block === SHARED) return this.sharedPieces(level).every((piece) => this.asked.has(keyOf(piece)));
    return this.asked.has(`${level}/${block}`);
  }

  private sharedPieces(level: number): Piece[] {
    return this.assembler.index.chunks.filter((chunk) => chunk.level === level && isShared(chunk)).map((chunk) => pieceOf(chunk));
  }
}
