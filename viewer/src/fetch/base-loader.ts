/** The file's bytes into the assembler: first the base, then what the policy asks for. */

import { Assembler } from "../format/assembler";
import type { Block } from "../format/block";
import type { BlockRecord } from "../format/directory";
import { ViewerError, asViewerError } from "../base/errors";
import { indexLength } from "../format/file-index";
import { HEADER_SIZE, Kind } from "../format/layout.gen";
import type { Lanes } from "./block-scheduler";
import { laterDecoder } from "../base/lazy-module";
import type { Look } from "../decode/level-view";
import type { Eye } from "../decode/messages";
import { levelPieces, pieceOf } from "../format/chunks";
import type { Piece } from "../format/chunks";
import { estimate } from "../policy/throughput";
import type { Sample } from "../policy/throughput";
import { Reader } from "./range-reader";
import type { ByteSource } from "./source";

/** A block's bytes, and its values if others unpack them. */
export interface Came {
  readonly piece: Piece;
  readonly bytes: Uint8Array;
  readonly unpacked?: Promise<Block> | undefined;
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
  /** A block is not held any more: what becomes of each look at it. */
  dropped(forget: (look: Look) => void): void;
  /** All is there that has room. */
  rest(bytes: number): void;
}

const SAMPLES_MAX = 200;
const SAMPLE_SECONDS = 0.1;
/** Times that a piece with a wrong checksum is asked for again. */
const REPAIRS = 3;

export class Loader {
  /** Finest level wanted. */
  cap = 0;
  /** Of the machine. */
  cores = 1;
  /** Whether nothing is to be asked for. */
  paused = false;
  bytes = 0;
  samples: readonly Sample[] = [];
  private assembler: Assembler | null = null;
  private readonly reader: Reader;
  private readonly shared = new Set<number>();
  private ready = 0;
  private window = { amount: 0, since: 0 };
  private eye: Eye | null = null;
  private lanes: Lanes | null = null;

  constructor(
    private readonly source: ByteSource,
    readonly events: LoaderEvents,
    abort: AbortController,
  ) {
    this.reader = new Reader(source, {
      came: (amount) => { this.count(amount); },
      notice: (text) => { events.notice(text || this.cut); },
    }, abort.signal);
  }

  /** Load until the wanted level is complete; goes on when `cap` rises. Ends with an error only. */
  async run(): Promise<void> {
    const head = await this.reader.head(HEADER_SIZE);
    const length = indexLength(head);
    const tables = (await this.reader.head(length)).subarray(0, length);
    const assembler = await this.repaired(0, tables, (bytes) => new Assembler(bytes));
    this.assembler = assembler;
    const { index } = assembler;
    this.checkSize();
    const front = index.chunks.filter((c) => c.kind === Kind.manifest || (index.header.front && c.kind === Kind.directory));
    await this.stream(front.map((c) => pieceOf(c)));
    this.events.header(assembler);
    if (this.cut) this.events.notice(this.cut);
    await this.stream(this.piecesOfLevel0());
    // The base has come: the line is free for the code that chooses what is next.
    const rest = laterDecoder.get();
    rest.catch(() => undefined);
    const { Lanes, loadDirectories } = await rest;
    await loadDirectories(this, assembler);
    this.lanes = new Lanes(this, assembler);
    if (this.eye) this.look(this.eye);
    await this.lanes.run();
  }

  /** Where the first request ends. */
  get stop(): number {
    return this.reader.stop;
  }

  /** Workers that unpack blocks. */
  get workers(): number {
    return this.lanes?.workers ?? 1;
  }

  /** Where the camera is now. */
  look(eye: Eye): void {
    this.lanes?.look(eye);
    this.eye = eye;
  }

  /** Something changed that may give work: the cap, or a pause. */
  poke(paused = this.paused): void {
    this.paused = paused;
    this.lanes?.poke();
  }

  /** Levels that the file holds: it may be a prefix of what its index tells of. */
  levelsInFile(): number {
    const { levels } = this.assembler!.index;
    const { size } = this.source;
    return size ? levels.filter((l) => l.end <= size).length : levels.length;
  }

  /** A file that was cut is the levels that it holds whole; there is no more than all of them. */
  private checkSize(): void {
    const { size } = this.source;
    const { levels } = this.assembler!.index;
    const { end } = levels[levels.length - 1];
    if (!size || (this.levelsInFile() && size <= end)) return;
    const first = size < levels[0].end ? `, its first level ends at ${levels[0].end}` : `, it should have ${end}`;
    throw new ViewerError("TruncatedError", `The file is incomplete: it has ${size} bytes${first}.`);
  }

  /** What is to be said of a file that ends within a level; empty if it does not. */
  get cut(): string {
    const { size } = this.source;
    const { levels } = this.assembler?.index ?? { levels: [] };
    if (!size || !levels.length || levels.some(({ end }) => end === size)) return "";
    const held = this.levelsInFile();
    const shown = held > 1 ? `levels 0 to ${held - 1}` : "level 0";
    return `This file was cut: ${size} of ${levels[levels.length - 1].end} bytes. It shows ${shown} of ${levels.length - 1}.`;
  }

  private piecesOfLevel0(): Piece[] {
    const { index, directories } = this.assembler!;
    const pieces: Piece[] = [];
    for (const chunk of index.chunks) {
      if (chunk.level > 0 || chunk.kind === Kind.manifest) continue;
      if (chunk.kind === Kind.directory && index.header.front) continue;
      if (chunk.kind === Kind.blocks && directories.length) pieces.push(...levelPieces(this.assembler!, 0));
      else pieces.push(pieceOf(chunk));
    }
    return pieces;
  }

  /** Fetch pieces that stand one after the other, and take each as soon as it is there. */
  async stream(pieces: readonly Piece[]): Promise<void> {
    const todo = pieces.slice();
    if (!todo.length) return;
    let at = todo[0].start;
    let rest = new Uint8Array(0);
    const takeWhole = async () => {
      while (todo.length && todo[0].stop <= at + rest.length) {
        const { start, stop } = todo[0];
        await this.take(todo[0], rest.slice(start - at, stop - at), todo);
        rest = rest.slice(stop - at);
        at = stop;
      }
    };
    this.window = { amount: 0, since: performance.now() / 1000 };
    await takeWhole();
    for await (const piece of this.reader.read(at, pieces[pieces.length - 1].stop)) {
      const joined = new Uint8Array(rest.length + piece.length);
      joined.set(rest);
      joined.set(piece, rest.length);
      rest = joined;
      await takeWhole();
    }
    if (todo.length) {
      throw new ViewerError("TruncatedError", `${this.source.name}: the file ends after ${at + rest.length} bytes; load it again.`);
    }
  }

  /** Use bytes that may be damaged: while their checksum is wrong they are asked for again, some times. */
  private async repaired<T>(start: number, bytes: Uint8Array, use: (bytes: Uint8Array) => T | Promise<T>): Promise<T> {
    const stop = start + bytes.length;
    for (let repairs = 0; ; repairs++) {
      try {
        return await use(bytes);
      } catch (error) {
        if (repairs === REPAIRS || asViewerError(error).trouble !== "ChecksumError") throw error;
      }
      bytes = await this.reader.again(start, stop);
    }
  }

  /** Give a piece to the assembler; more pieces of level 0 are known with its directory. */
  private async take(piece: Piece, bytes: Uint8Array, todo: Piece[]): Promise<void> {
    const assembler = this.assembler!;
    const { chunk, level, more } = piece;
    if (more) todo.splice(0, 1, ...await this.repaired(piece.start, bytes, more));
    else if (!chunk) {
      await (this.lanes ? this.lanes.handOut(piece, bytes) : this.takeBlock({ piece, bytes }));
      todo.shift();
    } else {
      await this.repaired(piece.start, bytes, (sound) => assembler.add(chunk, sound));
      todo.shift();
      if (chunk.kind === Kind.manifest) this.events.manifest(assembler);
      const last = todo[todo.length - 1] as Piece | undefined;
      if (chunk.kind === Kind.directory && !level && last?.chunk?.kind === Kind.blocks) {
        todo.splice(todo.length - 1, 1, ...levelPieces(assembler, 0));
      }
      assembler.index.levels.forEach((_, k) => {
        if (this.shared.has(k) || !assembler.hasShared(k)) return;
        this.shared.add(k);
        this.events.shared(k);
      });
    }
    this.tellReady();
  }

  private tellReady(): void {
    while (this.ready < this.assembler!.levelsReady) this.events.ready(this.ready++, this.bytes);
  }

  /** Put a block into the tables, whose parent is there. */
  async takeBlock(came: Came): Promise<void> {
    const assembler = this.assembler!;
    const { piece, bytes } = came;
    let { unpacked } = came;
    const { level, block } = piece;
    await this.repaired(piece.start, bytes, (sound) => {
      const begun = unpacked;
      unpacked = undefined;
      return assembler.addBlock(level, block, sound, begun);
    });
    this.events.block(level, assembler.directories[level][block]);
    this.tellReady();
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
