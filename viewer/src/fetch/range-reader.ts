/** Ranges to bytes in spite of a network: each byte once, resumed where a connection broke off. */

import { ViewerError, asViewerError } from "../base/errors";
import type { ByteSource } from "./source";

/**
 * Length of the first request where nobody knows how long the base is: index, directories and a small base. It
 * shares the line with the script and must not delay it, so it is shorter than that of stream/bootstrap.py;
 * public/index.html makes it.
 */
export const FIRST_BYTES = 40960;
const PATIENCE_SECONDS = [0.5, 1, 2, 4, 8];

export interface RangeReaderEvents {
  /** `amount` more bytes came. */
  received(amount: number): void;
  /** Trouble that may pass; empty when it has. */
  notice(text: string): void;
}

export class RangeReader {
  /** Bytes of the first request. */
  private readonly first: Uint8Array;
  private length = 0;
  /** End of the first request, bytes: its length, or that of a shorter file. */
  stop: number;
  private problem: ViewerError | null = null;
  private waiting: (() => void)[] = [];
  private lost = 0;

  constructor(
    private readonly source: ByteSource,
    private readonly events: RangeReaderEvents,
    private readonly signal: AbortSignal,
  ) {
    this.stop = source.first ?? FIRST_BYTES;
    this.first = new Uint8Array(this.stop);
    this.begin().catch((error: unknown) => {
      this.problem = asViewerError(error);
    }).finally(() => { this.wake(); });
  }

  /** At least so many of the first bytes, fewer if the file or the first request ends. */
  async head(least: number): Promise<Uint8Array> {
    while (this.length < Math.min(least, this.stop)) await this.more();
    return this.first.subarray(0, this.length);
  }

  /** A range, which may end earlier if the file does. */
  async *read(start: number, stop: number): AsyncGenerator<Uint8Array, void, void> {
    const split = Math.max(start, Math.min(stop, this.stop));
    // At once: what the first request brings is still on its way.
    const tail = this.resumed(split, stop);
    const begun = tail.next();
    begun.catch(() => undefined);
    try {
      for (let at = start; at < split;) {
        while (this.length <= at && at < this.stop) await this.more();
        const piece = this.first.subarray(at, Math.min(split, this.length));
        if (!piece.length) return;
        at += piece.length;
        yield piece;
      }
      const { value } = await begun;
      if (value) yield value;
      yield* tail;
    } finally {
      tail.return().catch(() => undefined);
    }
  }

  /** The same range from the source itself, past what is kept of it here and in caches. */
  async again(start: number, stop: number): Promise<Uint8Array> {
    const bytes = new Uint8Array(stop - start);
    let at = 0;
    for await (const piece of this.resumed(start, stop, true)) {
      bytes.set(piece, at);
      at += piece.length;
    }
    return bytes.subarray(0, at);
  }

  private async begin(): Promise<void> {
    for await (const piece of this.resumed(0, this.first.length)) {
      this.first.set(piece, this.length);
      this.length += piece.length;
      this.wake();
    }
    this.stop = this.length;
  }

  /** Wait for more of the first request, or its end. */
  private async more(): Promise<void> {
    if (!this.problem) await new Promise<void>((resolve) => this.waiting.push(resolve));
    if (this.problem) throw this.problem;
  }

  private wake(): void {
    for (const wake of this.waiting.splice(0)) wake();
  }

  private async *resumed(start: number, stop: number, fresh = false): AsyncGenerator<Uint8Array, void, void> {
    for (let at = start; at < stop;) {
      try {
        for await (const piece of this.source.read(at, stop, this.signal, fresh)) {
          this.recover();
          this.events.received(piece.length);
          at += piece.length;
          yield piece;
        }
        // What is shorter without an error ends with the file.
        return;
      } catch (error) {
        await this.patience(error);
      }
    }
  }

  /** Wait before another try; what will not go away is thrown. */
  private async patience(error: unknown): Promise<void> {
    const problem = asViewerError(error);
    if (problem.trouble !== "TransientError" || this.signal.aborted) throw problem;
    const usual = PATIENCE_SECONDS[Math.min(this.lost, PATIENCE_SECONDS.length - 1)];
    this.lost++;
    this.events.notice(`${problem.message} Trying again.`);
    await new Promise((resolve) => setTimeout(resolve, 1000 * Math.max(usual, problem.after)));
  }

  private recover(): void {
    if (this.lost) this.events.notice("");
    this.lost = 0;
  }
}
