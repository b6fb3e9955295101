/** Chunks and blocks, as they arrive, into an assembler's tables. */

import type { Assembler } from "../format/assembler";
import type { Block } from "../format/block";
import type { Piece } from "../format/chunks";
import type { BlockRecord } from "../format/directory";
import { Kind } from "../format/layout.gen";
import type { Download } from "./download";

/** A block's bytes, and its values if a worker unpacks them. */
export interface FetchedBlock {
  readonly piece: Piece;
  readonly bytes: Uint8Array;
  readonly unpacked?: Promise<Block> | undefined;
}

/** All calls come in the order of what they report. */
export interface TableEvents {
  manifest(assembler: Assembler): void;
  block(level: number, record: BlockRecord): void;
  /** Networks, codebook and grids of a level are there. */
  shared(level: number): void;
  /** All of a level is there, after so many bytes of the file. */
  ready(level: number, bytes: number): void;
}

export class TableWriter {
  /** Levels whose networks, codebook and grids are there. */
  private readonly shared = new Set<number>();
  private ready = 0;

  constructor(
    private readonly assembler: Assembler,
    private readonly download: Download,
    private readonly events: TableEvents,
  ) {}

  /** Use a chunk, or a page of a directory; pieces that it makes known are put among those that follow. */
  async takeChunk({ chunk, start, level, more }: Piece, bytes: Uint8Array, following: Piece[]): Promise<void> {
    const { assembler, download, events } = this;
    if (more) following.unshift(...await download.repaired(start, bytes, more));
    else if (chunk) {
      await download.repaired(start, bytes, (sound) => assembler.add(chunk, sound));
      if (chunk.kind === Kind.manifest) events.manifest(assembler);
      const last = following.at(-1);
      if (chunk.kind === Kind.directory && !level && last?.chunk?.kind === Kind.blocks) {
        following.splice(following.length - 1, 1, ...assembler.piecesOf(0));
      }
      assembler.index.levels.forEach((_, k) => {
        if (this.shared.has(k) || !assembler.hasShared(k)) return;
        this.shared.add(k);
        events.shared(k);
      });
    }
    this.reportReady();
  }

  /** Put a block into the tables, whose parent is there. */
  async takeBlock({ piece, bytes, unpacked }: FetchedBlock): Promise<void> {
    const { assembler } = this;
    const { level, block } = piece;
    let begun = unpacked;
    await this.download.repaired(piece.start, bytes, (sound) => {
      const first = begun;
      begun = undefined;
      return assembler.addBlock(level, block, sound, first);
    });
    this.events.block(level, assembler.directories[level][block]);
    this.reportReady();
  }

  private reportReady(): void {
    while (this.ready < this.assembler.levelsReady) this.events.ready(this.ready++, this.download.bytes);
  }
}
