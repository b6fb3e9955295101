/** The file's bytes into the assembler: first the base, then what the policy asks for. */

import { Assembler } from "./assembler";
import type { BlockRecord } from "./directory";
import { ViewerError, asViewerError } from "./errors";
import type { ChunkEntry } from "./file";
import { INDEX_BYTES_MAX, Kind } from "./layout.gen";
import type { Eye } from "./messages";
import { estimate, nextBlock } from "./policy";
import type { Sample } from "./policy";
import type { ByteSource } from "./source";
import { boxOf, shares } from "./views";
import type { Box } from "./views";

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
/** Neighbouring blocks are asked for together up to about this many bytes. */
const REQUEST_BYTES = 192 * 1024;
const SAMPLES_MAX = 200;
const SAMPLE_SECONDS = 0.1;
const PATIENCE_SECONDS = [0.5, 1, 2, 4, 8];

export class Loader {
  /** Finest level wanted. */
  cap = 0;
  eye: Eye | null = null;
  private assembler: Assembler | null = null;
  /** The file's first bytes, which small scenes are mostly made of. */
  private head = new Uint8Array(0);
  private readonly asked = new Set<string>();
  private readonly shared = new Set<number>();
  private ready = 0;
  private bytes = 0;
  private samples: Sample[] = [];
  private window = { amount: 0, since: 0 };
  private wake: (() => void)[] = [];
  private paused = false;
  private lost = 0;
  private shareOf: { eye: Eye | null; levels: Map<number, Float64Array> } = { eye: null, levels: new Map() };
  private boxes = new Map<number, Box[]>();

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
    await Promise.all(Array.from({ length: LANES }, () => this.lane()));
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
        for (const piece of pieces) this.asked.delete(keyOf(piece));
      }
      this.poke();
    }
  }

  /** The shared parts of the next level, or the next run of blocks. */
  private choose(): Piece[] | null {
    const assembler = this.assembler!;
    const { index, directories } = assembler;
    const cap = Math.min(this.cap, directories.length - 1, this.levelsInFile() - 1);
    const found = nextBlock({
      directories,
      cap,
      held: (level, block) => assembler.hasBlock(level, block),
      known: (level, block) => assembler.hasBlock(level, block) || this.asked.has(`${level}/${block}`),
      share: (level) => this.share(level),
    });
    if (!found) return null;
    const { level, block } = found;
    for (let k = 1; k <= level; k++) {
      if (assembler.hasShared(k)) continue;
      const parts = index.chunks.filter((c) => c.level === k && !([Kind.directory, Kind.blocks] as number[]).includes(c.kind));
      const lacking = parts.map((c) => pieceOf(c)).filter((p) => !this.asked.has(keyOf(p)));
      if (lacking.length) return lacking;
    }
    return this.runOf(level, block);
  }

  /** A block and those after it that may be asked for too. */
  private runOf(level: number, block: number): Piece[] {
    const assembler = this.assembler!;
    const records = assembler.directories[level];
    const pieces: Piece[] = [];
    let bytes = 0;
    for (let b = block; b < records.length && bytes < REQUEST_BYTES; b++) {
      if (assembler.hasBlock(level, b) || this.asked.has(`${level}/${b}`)) break;
      if (!assembler.hasBlock(level - 1, records[b].parent)) break;
      pieces.push(...blockPieces(level, [records[b]], b));
      bytes += records[b].stored;
    }
    return pieces;
  }

  private share(level: number): Float64Array {
    const assembler = this.assembler!;
    if (this.shareOf.eye !== this.eye) this.shareOf = { eye: this.eye, levels: new Map() };
    let found = this.shareOf.levels.get(level);
    if (!found) {
      let boxes = this.boxes.get(level);
      if (!boxes) {
        boxes = assembler.directories[level].map((b) => boxOf(b, assembler.index.header.voxel));
        this.boxes.set(level, boxes);
      }
      found = this.eye ? shares(boxes, this.eye) : new Float64Array(boxes.length);
      this.shareOf.levels.set(level, found);
    }
    return found;
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
    const { chunk, level, block } = piece;
    if (!chunk) {
      await assembler.addBlock(level, block, bytes);
      todo.shift();
      this.events.block(level, assembler.directories[level][block]);
    } else {
      await assembler.add(chunk, bytes);
      todo.shift();
      if (chunk.kind === Kind.manifest) this.events.manifest(assembler);
      const last = todo[todo.length - 1] as Piece | undefined;
      if (chunk.kind === Kind.directory && !level && last?.chunk?.kind === Kind.blocks) {
        todo.splice(todo.length - 1, 1, ...blockPieces(0, assembler.directories[0]));
      }
      if (assembler.hasShared(level) && !this.shared.has(level)) {
        this.shared.add(level);
        this.events.shared(level);
      }
    }
    while (this.ready < assembler.levelsReady) this.events.ready(this.ready++, this.bytes);
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
