/** The file's bytes into the assembler: first the base, then what the policy asks for. */

import { Assembler } from "./assembler";
import type { BlockRecord } from "./directory";
import { ViewerError, asViewerError } from "./errors";
import type { ChunkEntry } from "./file";
import { INDEX_BYTES_MAX, Kind } from "./layout.gen";
import type { Eye } from "./messages";
import { SHARED } from "./catalog";
import { Foresight } from "./foresight";
import { estimate } from "./policy";
import type { Sample } from "./policy";
import type { ByteSource } from "./source";

/** One chunk or block of the file: the smallest thing that is checked. */
interface Piece {
  readonly start: number;
  readonly stop: number;
  readonly chunk: ChunkEntry | null;
  readonly level: number;
  readonly block: number;
}

/** What happens; all calls come in order. */
export interface LoaderEvents {
  /** Index, manifest and directories as far as they lie before level 0. */
  header(assembler: Assembler): void;
  manifest(assembler: Assembler): void;
  block(level: number, record: BlockRecord): void;
  /** Networks, codebook and grids of a level have come. */
  shared(level: number): void;
  ready(level: number, bytes: number): void;
  progress(bytes: number, total: number, rate: number): void;
  notice(text: string): void;
}

/** Requests at once after the base. */
const LANES = 2;
const SAMPLES_MAX = 200;
const SAMPLE_SECONDS = 0.1;
const PATIENCE_SECONDS = [0.5, 1, 2, 4, 8];

export class Loader {
  /** Finest level wanted. */
  cap = 0;
  private assembler: Assembler | null = null;
  /** The file's first bytes, which small scenes are mostly made of. */
  private head = new Uint8Array(0);
  private readonly asked = new Set<string>();
  private readonly shared = new Set<number>();
  private readonly taken = new Set<string>();
  private ready = 0;
  private bytes = 0;
  private samples: Sample[] = [];
  private window = { amount: 0, since: 0 };
  private wake: (() => void)[] = [];
  private paused = false;
  private lost = 0;
  private eye: Eye | null = null;
  private foresight: Foresight | null = null;
  /** Blocks whose parents are still under way, by parent. */
  private readonly early = new Map<string, { piece: Piece; bytes: Uint8Array }[]>();

  constructor(
    private readonly source: ByteSource,
    private readonly events: LoaderEvents,
    private readonly abort: AbortController,
  ) {}

  /** Load until the wanted level is complete; goes on when `cap` rises. Ends with an error only. */
  async run(): Promise<void> {
    this.head = await this.fetch(0, INDEX_BYTES_MAX);
    const assembler = new Assembler(this.head);
    this.assembler = assembler;
    const { index } = assembler;
    if (this.source.size && !index.levels.some((l) => l.end === this.source.size)) {
      throw new ViewerError("TruncatedError", `The file is incomplete: it has ${this.source.size} bytes.`);
    }
    const front = index.chunks.filter((c) => c.kind === Kind.manifest || (index.header.front && c.kind === Kind.directory));
    await this.stream(front.map((c) => pieceOf(c)));
    this.events.header(assembler);
    await this.stream(this.piecesOfLevel0());
    await this.loadDirectories();
    this.foresight = new Foresight(assembler);
    if (this.eye) this.look(this.eye);
    await Promise.all(Array.from({ length: LANES }, () => this.lane()));
  }

  /** Where the camera is now. */
  look(eye: Eye): void {
    this.foresight?.look(eye, performance.now() / 1000);
    this.eye = eye;
  }

  /** Something changed that may give work: the cap, or a pause. */
  poke(paused = this.paused): void {
    this.paused = paused;
    for (const wake of this.wake.splice(0)) wake();
  }

  /** Levels that the file holds: it may be a prefix of what its index tells of. */
  levelsInFile(): number {
    const { levels } = this.assembler!.index;
    const { size } = this.source;
    return size ? levels.filter((l) => l.end <= size).length : levels.length;
  }

  private piecesOfLevel0(): Piece[] {
    const { index, directories } = this.assembler!;
    const pieces: Piece[] = [];
    for (const chunk of index.chunks) {
      if (chunk.level > 0 || chunk.kind === Kind.manifest) continue;
      if (chunk.kind === Kind.directory && index.header.front) continue;
      if (chunk.kind === Kind.blocks && directories.length) pieces.push(...blockPieces(0, directories[0]));
      else pieces.push(pieceOf(chunk));
    }
    return pieces;
  }

  /** Directories that stand at the beginning of their levels. */
  private async loadDirectories(): Promise<void> {
    const { index, directories } = this.assembler!;
    for (const chunk of index.chunks) {
      if (chunk.kind !== Kind.directory || directories.length > chunk.level) continue;
      if (chunk.level < this.levelsInFile()) await this.stream([pieceOf(chunk)]);
    }
  }

  private async lane(): Promise<never> {
    for (;;) {
      const pieces = this.paused ? null : this.choose();
      if (!pieces) {
        await new Promise<void>((resolve) => this.wake.push(resolve));
        continue;
      }
      for (const piece of pieces) this.asked.add(keyOf(piece));
      try {
        await this.stream(pieces);
      } finally {
        // A block that waits for its parent stays under way until that is there.
        const waits = new Set([...this.early.values()].flat().map(({ piece }) => keyOf(piece)));
        for (const piece of pieces) if (!waits.has(keyOf(piece))) this.asked.delete(keyOf(piece));
      }
      this.poke();
    }
  }

  /** Blocks and shared parts of levels, side by side: what the policy asks for next. */
  private choose(): Piece[] | null {
    const assembler = this.assembler!;
    const { index, directories } = assembler;
    const levels = Math.min(this.cap + 1, directories.length, this.levelsInFile());
    const run = this.foresight!.next(levels, this.samples, (level, block) => this.isKnown(level, block));
    const pieces = run.flatMap(({ level, block }) => (block === SHARED
      ? index.chunks.filter((c) => c.level === level && isShared(c)).map((c) => pieceOf(c))
      : blockPieces(level, [directories[level][block]], block)));
    return pieces.length ? pieces : null;
  }

  /** Whether a block, or what the blocks of a level share, is held or under way. */
  private isKnown(level: number, block: number): boolean {
    const assembler = this.assembler!;
    if (level === 0) return true;
    if (block !== SHARED) return assembler.hasBlock(level, block) || this.asked.has(`${level}/${block}`);
    return assembler.index.chunks.every((chunk) => {
      const key = keyOf(pieceOf(chunk));
      return chunk.level !== level || !isShared(chunk) || this.taken.has(key) || this.asked.has(key);
    });
  }

  /** Fetch pieces that stand one after the other, and take each as soon as it is there. */
  private async stream(pieces: readonly Piece[]): Promise<void> {
    const todo = pieces.slice();
    while (todo.length) {
      const first = todo[0];
      if (first.stop <= this.head.length) {
        await this.take(first, this.head.subarray(first.start, first.stop), todo);
        continue;
      }
      const end = todo[todo.length - 1].stop;
      try {
        await this.streamOnce(todo, end);
        this.recover();
      } catch (error) {
        await this.patience(error);
      }
    }
  }

  private async streamOnce(todo: Piece[], end: number): Promise<void> {
    let at = todo[0].start;
    let rest = new Uint8Array(0);
    while (todo.length && todo[0].stop === todo[0].start) await this.take(todo[0], rest, todo);
    if (at >= end) return;
    this.window = { amount: 0, since: performance.now() / 1000 };
    for await (const piece of this.source.read(at, end, this.abort.signal)) {
      this.recover();
      this.count(piece.length);
      const joined = new Uint8Array(rest.length + piece.length);
      joined.set(rest);
      joined.set(piece, rest.length);
      rest = joined;
      while (todo.length && todo[0].stop <= at + rest.length) {
        const { start, stop } = todo[0];
        await this.take(todo[0], rest.slice(start - at, stop - at), todo);
        rest = rest.slice(stop - at);
        at = stop;
      }
    }
    if (todo.length && at + rest.length < end) {
      throw new ViewerError("TransientError", "The connection broke off.");
    }
  }

  /** Give a piece to the assembler; more pieces of level 0 are known with its directory. */
  private async take(piece: Piece, bytes: Uint8Array, todo: Piece[]): Promise<void> {
    const assembler = this.assembler!;
    const { chunk, level } = piece;
    if (!chunk) {
      await this.takeBlock(piece, bytes);
      todo.shift();
    } else {
      await assembler.add(chunk, bytes);
      todo.shift();
      if (chunk.kind === Kind.manifest) this.events.manifest(assembler);
      const last = todo[todo.length - 1] as Piece | undefined;
      if (chunk.kind === Kind.directory && !level && last?.chunk?.kind === Kind.blocks) {
        todo.splice(todo.length - 1, 1, ...blockPieces(0, assembler.directories[0]));
      }
      this.taken.add(keyOf(piece));
      assembler.index.levels.forEach((_, k) => {
        if (this.shared.has(k) || !assembler.hasShared(k)) return;
        this.shared.add(k);
        this.events.shared(k);
      });
    }
    while (this.ready < assembler.levelsReady) this.events.ready(this.ready++, this.bytes);
  }

  private async takeBlock(piece: Piece, bytes: Uint8Array): Promise<void> {
    const assembler = this.assembler!;
    const { level, block } = piece;
    const name = `${level}/${block}`;
    const record = assembler.directories[level][block];
    const parent = `${level - 1}/${record.parent}`;
    if (level && !assembler.hasBlock(level - 1, record.parent)) {
      this.early.set(parent, [...(this.early.get(parent) ?? []), { piece, bytes }]);
      return;
    }
    await assembler.addBlock(level, block, bytes);
    this.asked.delete(name);
    this.events.block(level, record);
    const waiting = this.early.get(name) ?? [];
    this.early.delete(name);
    for (const child of waiting) await this.takeBlock(child.piece, child.bytes);
  }

  /** The bytes of a range, which may end earlier if the file does. */
  private async fetch(start: number, stop: number): Promise<Uint8Array<ArrayBuffer>> {
    const parts: Uint8Array[] = [];
    let at = start;
    for (;;) {
      try {
        const end = this.source.size ? Math.min(stop, this.source.size) : stop;
        if (at >= end) return new Uint8Array(await new Blob(parts as BlobPart[]).arrayBuffer());
        for await (const piece of this.source.read(at, end, this.abort.signal)) {
          this.count(piece.length);
          parts.push(piece);
          at += piece.length;
        }
        this.recover();
        if (!this.source.size) return new Uint8Array(await new Blob(parts as BlobPart[]).arrayBuffer());
      } catch (error) {
        await this.patience(error);
      }
    }
  }

  /** Wait before another try; what will not go away is thrown. */
  private async patience(error: unknown): Promise<void> {
    const problem = asViewerError(error);
    if (problem.trouble !== "TransientError" || this.abort.signal.aborted) throw problem;
    const usual = PATIENCE_SECONDS[Math.min(this.lost, PATIENCE_SECONDS.length - 1)];
    this.lost++;
    this.events.notice(`${problem.message} Trying again.`);
    await new Promise((resolve) => setTimeout(resolve, 1000 * Math.max(usual, problem.after)));
  }

  private recover(): void {
    if (this.lost) this.events.notice("");
    this.lost = 0;
  }

  private count(amount: number): void {
    const now = performance.now() / 1000;
    const { window } = this;
    this.bytes += amount;
    window.amount += amount;
    const seconds = now - window.since;
    if (seconds >= SAMPLE_SECONDS) {
      this.samples = [...this.samples.slice(1 - SAMPLES_MAX), { amount: window.amount, seconds }];
      this.window = { amount: 0, since: now };
    }
    const last = this.assembler?.index.levels[Math.min(this.cap, this.assembler.index.levels.length - 1)];
    this.events.progress(this.bytes, last?.end ?? 0, 8 * estimate(this.samples));
  }
}

/** Whether all blocks of its level need a chunk. */
function isShared({ kind }: ChunkEntry): boolean {
  return !([Kind.manifest, Kind.directory, Kind.blocks] as number[]).includes(kind);
}

function pieceOf(chunk: ChunkEntry): Piece {
  return { start: chunk.offset, stop: chunk.offset + chunk.stored, chunk, level: chunk.level, block: -1 };
}

function blockPieces(level: number, records: readonly BlockRecord[], first = 0): Piece[] {
  return records.map((record, i) => ({
    start: record.offset,
    stop: record.offset + record.stored,
    chunk: null,
    level,
    block: first + i,
  }));
}

function keyOf(piece: Piece): string {
  return piece.chunk ? `chunk ${piece.start}` : `${piece.level}/${piece.block}`;
}
