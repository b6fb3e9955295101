/** The bytes of one file: counted and timed as they arrive, cut into chunks and blocks, repaired where they are damaged. */

import { ViewerError, asViewerError } from "../base/errors";
import type { Piece } from "../format/chunks";
import type { Sample } from "../policy/throughput";
import { RangeReader } from "./range-reader";
import type { ByteSource } from "./source";

/** Takes a piece's bytes; `following` are the pieces behind it, to which it may add. */
export type TakePiece = (piece: Piece, bytes: Uint8Array, following: Piece[]) => Promise<void>;

const SAMPLES_MAX = 200;
const SAMPLE_SECONDS = 0.1;
/** Share of a request that counts once another has come. */
const FADES = 0.9;
/** Times that a piece with a wrong checksum is requested again. */
const REPAIRS = 3;

export interface DownloadEvents {
  /** `bytes` and perhaps `samples` have grown. */
  progress(): void;
  /** A problem that may pass; empty when it has. */
  notice(text: string): void;
}

export class Download {
  bytes = 0;
  /** Throughput of the last seconds, oldest first. */
  samples: readonly Sample[] = [];
  readonly reader: RangeReader;
  private window = { amount: 0, since: 0 };
  /** Bytes of requests and the milliseconds that they took; old ones fade. */
  private came = 0;
  private took = 0;

  constructor(
    private readonly source: ByteSource,
    private readonly events: DownloadEvents,
    signal: AbortSignal,
  ) {
    this.reader = new RangeReader(source, {
      received: (amount) => { this.count(amount); },
      notice: (text) => { events.notice(text); },
    }, signal);
    new PerformanceObserver((list) => {
      for (const { encodedBodySize, duration } of list.getEntries() as PerformanceResourceTiming[]) {
        this.came = FADES * this.came + encodedBodySize;
        this.took = FADES * this.took + duration;
      }
    }).observe({ type: "resource" });
  }

  /**
   * Bytes per second of the line by the browser's clock, which does not wait for this thread to look; 0 where a server of
   * another origin hides them, not a number before any came.
   */
  get lineRate(): number {
    return (1000 * this.came) / this.took;
  }

  /** Fetch pieces that stand one after the other, and hand out each as soon as it is there. */
  async stream(pieces: readonly Piece[], take: TakePiece): Promise<void> {
    const todo = pieces.slice();
    if (!todo.length) return;
    let at = todo[0].start;
    let rest = new Uint8Array(0);
    const takeWhole = async () => {
      while (todo.length && todo[0].stop <= at + rest.length) {
        const piece = todo.shift()!;
        await take(piece, rest.slice(piece.start - at, piece.stop - at), todo);
        rest = rest.slice(piece.stop - at);
        at = piece.stop;
      }
    };
    this.window = { amount: 0, since: performance.now() / 1000 };
    await takeWhole();
    for await (const received of this.reader.read(at, pieces[pieces.length - 1].stop)) {
      const joined = new Uint8Array(rest.length + received.length);
      joined.set(rest);
      joined.set(received, rest.length);
      rest = joined;
      await takeWhole();
    }
    if (todo.length) {
      throw new ViewerError("TruncatedError", `${this.source.name}: the file ends after ${at + rest.length} bytes; load it again.`);
    }
  }

  /** Use bytes that may be damaged: while their checksum is wrong they are requested again, `REPAIRS` times. */
  async repaired<T>(start: number, bytes: Uint8Array, use: (bytes: Uint8Array) => T | Promise<T>): Promise<T> {
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
    this.events.progress();
  }
}
