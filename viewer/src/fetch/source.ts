/** Bytes of a file by ranges: from a web server, a local file or memory. */

import { receivePreloadedResponse } from "./preloaded-response";
import type { PreloadedResponse } from "./preloaded-response";
import { ViewerError } from "../base/errors";

/** Reads ranges; pieces arrive in order and are never more than what was asked for. */
export interface ByteSource {
  /** Name in messages. */
  readonly name: string;
  /** Length of the file, 0 while it is not known. */
  readonly size: number;
  /** Bytes of the first request, if it is made already. */
  readonly first?: number;
  /** `fresh`: not out of a cache. */
  read(start: number, stop: number, signal: AbortSignal, fresh?: boolean): AsyncGenerator<Uint8Array, void, void>;
}

/** Bytes that are kept in memory where a server has no ranges. */
const WHOLE_MAX = 256 * 2 ** 20;
const BUSY = [408, 425, 429, 500, 502, 503, 504];
/** Milliseconds without a byte after which a read breaks off. */
const PATIENCE = 10_000;

/** A dropped or embedded file. */
export class BlobSource implements ByteSource {
  readonly size: number;

  constructor(
    private readonly blob: Blob,
    readonly name: string,
  ) {
    this.size = blob.size;
  }

  async *read(start: number, stop: number): AsyncGenerator<Uint8Array, void, void> {
    if (start >= this.size) throw truncatedError(this.name, this.size);
    yield new Uint8Array(await this.blob.slice(start, stop).arrayBuffer());
  }
}

/** Identity of one version of a file; empty parts are not known. */
interface FileVersion {
  readonly tag: string;
  readonly modified: string;
  readonly size: number;
}

/** One address, read in ranges; the whole file once where ranges do not work. */
export class HttpSource implements ByteSource {
  readonly name: string;
  size = 0;
  readonly first?: number;
  private preloaded: MessagePort | null;
  private stamp: FileVersion | null = null;
  private whole: Promise<Uint8Array> | null = null;

  /** `preloaded`: the answer to the first request, if the page has made it. */
  constructor(private readonly address: string, preloaded: PreloadedResponse | null = null) {
    this.name = address.split("?")[0];
    this.preloaded = preloaded && preloaded.port;
    if (preloaded) this.first = preloaded.first;
  }

  async *read(start: number, stop: number, signal: AbortSignal, fresh = false): AsyncGenerator<Uint8Array, void, void> {
    if (fresh) this.whole = null;
    if (!this.whole) {
      const { response, cors, give } = await this.ask(`bytes=${start}-${stop - 1}`, signal, fresh);
      const length = this.rangeLength(response, cors, start, stop);
      if (length) {
        yield* pieces(response, length, this.name, give);
        return;
      }
      // Without ranges an answer holds the whole file: read it once, cut ranges here.
      this.whole ??= this.readWhole(response, give);
    }
    let bytes: Uint8Array;
    try {
      bytes = await this.whole;
    } catch (error) {
      this.whole = null;
      throw error;
    }
    if (start >= bytes.length) throw truncatedError(this.name, bytes.length);
    yield bytes.subarray(start, stop);
  }

  private async ask(range: string | null, signal: AbortSignal, fresh = false) {
    const give = new AbortController();
    signal.addEventListener("abort", () => { give.abort(); }, { once: true });
    const headers: Record<string, string> = range ? { Range: range } : {};
    if (range && this.stamp?.tag.startsWith('"')) headers["If-Range"] = this.stamp.tag;
    const clock = setTimeout(() => { give.abort(); }, PATIENCE);
    const cache = fresh ? "reload" : this.stamp ? "default" : "no-cache";
    let response: Response;
    let cors = false;
    try {
      const made = this.preloaded && (await receivePreloadedResponse(this.preloaded, give.signal));
      this.preloaded = null;
      response = made?.response ?? (await fetch(this.address, { headers, signal: give.signal, cache }));
      cors = made?.cors ?? response.type === "cors";
    } catch {
      if (signal.aborted) throw new ViewerError("TransientError", "stopped");
      throw new ViewerError(
        "TransientError",
        `${this.name} cannot be reached: no connection, or the server does not allow this page to read it (CORS).`,
      );
    } finally {
      clearTimeout(clock);
    }
    this.check(response);
    return { response, cors, give };
  }

  /** Refuse a status other than 200 and 206, and a version that is not the first one. */
  private check(response: Response): void {
    const { status } = response;
    if (BUSY.includes(status)) {
      // A date, or nothing, is no number.
      const seconds = Math.min(60, Number(response.headers.get("retry-after"))) || 0;
      throw new ViewerError("TransientError", `${this.name}: the server answers ${status}.`, seconds);
    }
    if (status === 416) throw truncatedError(this.name, sizeOf(response));
    if (status !== 200 && status !== 206) {
      const why = status === 404 ? "There is no such file" : `The server answers ${status}`;
      throw new ViewerError("SourceError", `${why}: ${this.name}`);
    }
    const stamp = stampOf(response);
    const before = this.stamp;
    if (before) {
      const changed = (["tag", "modified", "size"] as const).some(
        (key) => before[key] && stamp[key] && before[key] !== stamp[key],
      );
      if (changed) {
        throw new ViewerError("ChangedError", `${this.name} was replaced while it was read; load the page again.`);
      }
    } else {
      this.stamp = stamp;
      this.size = stamp.size;
    }
  }

  /** Bytes of an answer that is the very range, or its part within the file; 0 if it is not. */
  private rangeLength(response: Response, cors: boolean, start: number, stop: number): number {
    if (response.status !== 206 || response.headers.get("content-encoding")) return 0;
    const text = response.headers.get("content-range");
    if (text === null && cors) {
      // Hidden from this page by the server; every piece has a checksum.
      const length = Number(response.headers.get("content-length") ?? 0);
      return length <= stop - start ? length : 0;
    }
    const match = /^bytes (\d+)-(\d+)\/(\d+|\*)$/.exec(text ?? "");
    if (!match || Number(match[1]) !== start) return 0;
    const end = Number(match[2]) + 1;
    const clipped = end === Number(match[3]) && end < stop;
    return end === stop || clipped ? end - start : 0;
  }

  private async readWhole(response: Response, give: AbortController): Promise<Uint8Array> {
    let answer = { response, give };
    if (response.status !== 200) {
      give.abort();
      answer = await this.ask(null, new AbortController().signal);
    }
    const parts: BlobPart[] = [];
    let length = 0;
    for await (const piece of bodyOf(answer.response, answer.give, this.name)) {
      length += piece.length;
      if (length > WHOLE_MAX) {
        answer.give.abort();
        throw new ViewerError("SourceError", `${this.name}: the server has no ranges and the file is too large to be read whole.`);
      }
      parts.push(piece as Uint8Array<ArrayBuffer>);
    }
    this.size = length;
    return new Uint8Array(await new Blob(parts).arrayBuffer());
  }
}

/** Length of the file by an answer to a range, 0 if it does not say. */
function sizeOf({ headers }: Response): number {
  return Number(/\/(\d+)$/.exec(headers.get("content-range") ?? "")?.[1] ?? 0);
}

function stampOf(response: Response): FileVersion {
  const { headers } = response;
  let size = sizeOf(response);
  const plain = !headers.get("content-encoding");
  if (response.status === 200 && plain) size = Number(headers.get("content-length") ?? 0);
  return { tag: plain ? (headers.get("etag") ?? "") : "", modified: headers.get("last-modified") ?? "", size };
}

/** The body, exactly as long as wanted. */
async function* pieces(response: Response, wanted: number, name: string, give: AbortController) {
  let got = 0;
  for await (const piece of bodyOf(response, give, name)) {
    got += piece.length;
    if (got > wanted) {
      give.abort();
      throw new ViewerError("SourceError", `${name}: more bytes than asked for`);
    }
    yield piece;
  }
  if (got < wanted) throw new ViewerError("TransientError", `${name}: the connection broke off.`);
}

async function* bodyOf(response: Response, give: AbortController, name: string): AsyncGenerator<Uint8Array, void, void> {
  const reader = response.body?.getReader();
  if (!reader) return;
  try {
    for (;;) {
      const clock = setTimeout(() => { give.abort(); }, PATIENCE);
      let piece: ReadableStreamReadResult<Uint8Array>;
      try {
        piece = await reader.read();
      } catch {
        throw new ViewerError("TransientError", `${name}: the connection broke off.`);
      } finally {
        clearTimeout(clock);
      }
      if (piece.done) return;
      yield piece.value;
    }
  } finally {
    reader.cancel().catch(() => undefined);
  }
}

function truncatedError(name: string, size: number): ViewerError {
  return new ViewerError("TruncatedError", `${name}: the file ends ${size ? `after ${size} bytes` : "too soon"}; load it again.`);
}
