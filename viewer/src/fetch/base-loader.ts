/** The first part of a file, up to its coarsest level; from then on the block scheduler decides what to fetch. */

import { ViewerError } from "../base/errors";
import { LazyModule } from "../base/lazy-module";
import type { ViewPose } from "../base/view-pose";
import { Assembler } from "../format/assembler";
import { isBlock, pieceOf } from "../format/chunks";
import type { Piece } from "../format/chunks";
import type { BlockRecord } from "../format/directory";
import { indexLength } from "../format/file-index";
import { HEADER_SIZE, Kind } from "../format/layout.gen";
import { estimateThroughput } from "../policy/throughput";
import type * as blockScheduler from "./block-scheduler";
import { Download } from "./download";
import type { ByteSource } from "./source";
import { TableWriter } from "./table-writer";
import type { TableEvents } from "./table-writer";

/** Code for all that follows the coarsest level. */
export const schedulerModule = new LazyModule<typeof blockScheduler>();

/** All calls come in the order of what they report. */
export interface LoaderEvents extends TableEvents {
  /** Index, manifest and directories as far as they lie before level 0. */
  header(assembler: Assembler): void;
  /** `bytes` of `total` have come, at `rate` bits per second. */
  progress(bytes: number, total: number, rate: number): void;
  notice(text: string): void;
  /** A block was evicted from the tables. */
  dropped(level: number, record: BlockRecord): void;
  /** Nothing more is to be fetched that there are rows for. */
  rest(bytes: number): void;
}

export class Loader {
  /** Finest level wanted. */
  cap = 0;
  /** Cores of the machine. */
  cores = 1;
  /** Nothing is to be requested. */
  paused = false;
  private readonly download: Download;
  private assembler: Assembler | null = null;
  private view: ViewPose | null = null;
  private scheduler: blockScheduler.BlockScheduler | null = null;

  constructor(
    private readonly source: ByteSource,
    private readonly events: LoaderEvents,
    abort: AbortController,
  ) {
    this.download = new Download(source, {
      progress: () => { this.reportProgress(); },
      notice: (text) => { events.notice(text || this.cut); },
    }, abort.signal);
  }

  /** Load until the wanted level is complete; goes on when `cap` rises. Ends with an error only. */
  async run(): Promise<void> {
    const { download, events } = this;
    const head = await download.reader.head(HEADER_SIZE);
    const length = indexLength(head);
    const tables = (await download.reader.head(length)).subarray(0, length);
    const assembler = await download.repaired(0, tables, (bytes) => new Assembler(bytes));
    this.assembler = assembler;
    const { index } = assembler;
    this.checkSize();
    const writer = new TableWriter(assembler, download, events);
    const take = (piece: Piece, bytes: Uint8Array, following: Piece[]) =>
      isBlock(piece) ? writer.takeBlock({ piece, bytes }) : writer.takeChunk(piece, bytes, following);
    const front = index.chunks.filter((c) => c.kind === Kind.manifest || (index.header.front && c.kind === Kind.directory));
    await download.stream(front.map((c) => pieceOf(c)), take);
    events.header(assembler);
    if (this.cut) events.notice(this.cut);
    await download.stream(this.piecesOfLevel0(), take);
    // The base has come: the connection is free for the code that chooses what is next.
    const rest = schedulerModule.get();
    rest.catch(() => undefined);
    const { BlockScheduler, loadDirectories } = await rest;
    await loadDirectories(assembler, download, writer, this.levelsInFile());
    this.scheduler = new BlockScheduler(assembler, download, writer, this, events);
    if (this.view) this.look(this.view);
    await this.scheduler.run();
  }

  /** Workers that unpack blocks. */
  get workers(): number {
    return this.scheduler?.workers ?? 1;
  }

  /** The camera is here now. */
  look(view: ViewPose): void {
    this.scheduler?.look(view);
    this.view = view;
  }

  /** Something changed that may give work: the cap, or a pause. */
  poke(paused = this.paused): void {
    this.paused = paused;
    this.scheduler?.poke();
  }

  /** Levels that the file holds: it may be a prefix of the one that its index describes. */
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

  /** The message on a file that ends within a level; empty if it does not. */
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
      if (chunk.kind === Kind.blocks && directories.length) pieces.push(...this.assembler!.piecesOf(0));
      else pieces.push(pieceOf(chunk));
    }
    return pieces;
  }

  private reportProgress(): void {
    const { bytes, samples } = this.download;
    const last = this.assembler?.index.levels[Math.min(this.cap, this.assembler.index.levels.length - 1)];
    this.events.progress(bytes, last?.end ?? 0, 8 * estimateThroughput(samples));
  }
}
