/** Chunks and blocks of a file: the smallest things that are checked. */

import type { BlockRecord } from "./directory";
import type { ChunkEntry } from "./file-index";
import { Kind } from "./layout.gen";

export interface Piece {
  readonly start: number;
  readonly stop: number;
  readonly chunk: ChunkEntry | null;
  readonly level: number;
  readonly block: number;
  /** Takes the bytes of a page: the pieces that follow it. */
  readonly more?: (bytes: Uint8Array) => Promise<Piece[]>;
}

/** True for a chunk that all blocks of its level need. */
export function isShared({ kind }: ChunkEntry): boolean {
  return !([Kind.manifest, Kind.directory, Kind.blocks] as number[]).includes(kind);
}

export function pieceOf(chunk: ChunkEntry): Piece {
  return { start: chunk.offset, stop: chunk.offset + chunk.stored, chunk, level: chunk.level, block: -1 };
}

export function blockPieces(level: number, records: readonly BlockRecord[], first = 0): Piece[] {
  return records.map((record, i) => ({
    start: record.offset,
    stop: record.offset + record.stored,
    chunk: null,
    level,
    block: first + i,
  }));
}

/** A spatial block, not a chunk or a page of a directory. */
export function isBlock({ chunk, more }: Piece): boolean {
  return !chunk && !more;
}

export function keyOf(piece: Piece): string {
  return piece.chunk ? `chunk ${piece.start}` : `${piece.level}/${piece.block}`;
}
