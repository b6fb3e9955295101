/** CRC-32, DEFLATE and byte planes: the layer below arrays of values. */

import { freeMemory } from "../base/free-memory";
import { ViewerError, mismatch } from "../base/errors";

const TABLES = crcTables();

/** Eight tables, so that eight bytes take one step. */
function crcTables(): Uint32Array[] {
  const tables = [new Uint32Array(256)];
  for (let n = 0; n < 256; n++) {
    let c = n;
    for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
    tables[0][n] = c >>> 0;
  }
  for (let t = 1; t < 8; t++) {
    tables.push(tables[t - 1].map((c) => (tables[0][c & 0xff] ^ (c >>> 8)) >>> 0));
  }
  return tables;
}

/** CRC-32 as in zlib, continued from `crc`. */
export function crc32(bytes: Uint8Array, crc = 0): number {
  const [t0, t1, t2, t3, t4, t5, t6, t7] = TABLES;
  let c = ~crc;
  let i = 0;
  for (const end = bytes.length - 7; i < end; i += 8) {
    c ^= bytes[i] | (bytes[i + 1] << 8) | (bytes[i + 2] << 16) | (bytes[i + 3] << 24);
    c =
      t7[c & 0xff] ^ t6[(c >>> 8) & 0xff] ^ t5[(c >>> 16) & 0xff] ^ t4[c >>> 24] ^
      t3[bytes[i + 4]] ^ t2[bytes[i + 5]] ^ t1[bytes[i + 6]] ^ t0[bytes[i + 7]];
  }
  for (; i < bytes.length; i++) c = t0[(c ^ bytes[i]) & 0xff] ^ (c >>> 8);
  return ~c >>> 0;
}

/** Stored length, raw length and checksum of a chunk or block. */
export interface Span {
  readonly stored: number;
  readonly raw: number;
  readonly crc: number;
}

/** The raw bytes of a chunk or block whose length and checksum are right. */
export async function rawBytes(bytes: Uint8Array, span: Span, where: string): Promise<Uint8Array> {
  if (bytes.length !== span.stored) {
    throw mismatch("TruncatedError", where, `${bytes.length} bytes`, span.stored);
  }
  const crc = crc32(bytes);
  if (crc !== span.crc) {
    const [found, expected] = [crc, span.crc].map((c) => c.toString(16).padStart(8, "0"));
    throw new ViewerError(
      "ChecksumError",
      `${where}: found CRC-32 ${found}, expected ${expected}; the bytes were changed, load the file again`,
    );
  }
  return span.stored === span.raw ? bytes : inflate(bytes, span.raw, where);
}

/**
 * Inflate a raw DEFLATE stream that gives exactly `length` bytes and ends with the last of `bytes`;
 * never hold more.
 */
async function inflate(bytes: Uint8Array, length: number, where: string): Promise<Uint8Array> {
  const bad = (what: string) => new ViewerError("LayoutError", `${where}: ${what}`);
  const raw = new Uint8Array(length);
  const found = await inflated(bytes, raw);
  if (found === null) throw bad("no DEFLATE stream");
  if (found > length) throw bad(`more than ${length} inflated bytes`);
  if (found !== length) throw bad(`${found} inflated bytes instead of ${length}`);
  // A stream that is whole without its last byte ended before it.
  if (await ignoresTails() && (await inflated(bytes.subarray(0, -1), raw.slice())) !== null) {
    throw bad("bytes after the end of the DEFLATE stream");
  }
  return raw;
}

let ignored: Promise<boolean> | null = null;

/** True where the platform accepts bytes behind the end of a stream: no browser does, Node 20 does. */
function ignoresTails(): Promise<boolean> {
  // An empty block with static codes, and a byte.
  ignored ??= inflated(Uint8Array.of(3, 0, 0), new Uint8Array(0)).then((found) => found !== null);
  return ignored;
}

/** Fill `raw`; how many bytes there were, at least one more if they are too many, null if it is no stream. */
async function inflated(bytes: Uint8Array, raw: Uint8Array): Promise<number | null> {
  const stream = new DecompressionStream("deflate-raw");
  const writer = stream.writable.getWriter();
  // A refusal shows on the reading side; these promises would only repeat it.
  writer.write(bytes as Uint8Array<ArrayBuffer>).catch(() => undefined);
  writer.close().catch(() => undefined);
  const reader = stream.readable.getReader();
  let at = 0;
  for (;;) {
    let piece: ReadableStreamReadResult<Uint8Array>;
    try {
      piece = await reader.read();
    } catch {
      return null;
    }
    if (piece.done) return at;
    if (at + piece.value.length > raw.length) {
      reader.cancel().catch(() => undefined);
      return at + piece.value.length;
    }
    raw.set(piece.value, at);
    at += piece.value.length;
    freeMemory(piece.value);
  }
}

/** The bytes of an array [rows, columns] row after row, from planes of bytes: column after column, in each the lowest bytes first. */
export function fromPlanes(raw: Uint8Array, rows: number, columns: number, width: number): ArrayBuffer {
  const out = new Uint8Array(rows * columns * width);
  for (let column = 0, from = 0; column < columns; column++) {
    for (let b = 0; b < width; b++) {
      for (let row = 0, to = column * width + b; row < rows; row++, to += columns * width) out[to] = raw[from++];
    }
  }
  return out.buffer;
}
