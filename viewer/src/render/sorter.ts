/** The order in which splats are drawn: far to near, by a counting sort. */

import type { Side } from "../decode/messages";

/** Buckets of depth; float32 bits of a positive number rise with it, so they serve as key. */
const BUCKET_BITS = 16;
/** A splat is drawn now; it was drawn before a change that is still seen. */
const NOW = 1;
const BEFORE = 2;

/** Splats that one side draws: those below `limit` that are marked, and those from before a change. */
class Marks {
  limit = 0;
  /** Splats below this may be from before. */
  before = 0;
  readonly marks: Uint8Array;

  constructor(capacity: number) {
    this.marks = new Uint8Array(capacity);
  }

  set(first: number, drawn: Uint8Array, limit: number, fade: boolean): void {
    const { marks } = this;
    if (fade) this.keep();
    const count = Math.min(drawn.length, marks.length - first);
    for (let i = 0; i < count; i++) marks[first + i] = (marks[first + i] & BEFORE) | (drawn[i] ? NOW : 0);
    this.limit = Math.min(limit, marks.length);
  }

  /** Keep the splats drawn now as those from before a change. */
  private keep(): void {
    const { marks, limit } = this;
    for (let i = 0; i < limit; i++) if (marks[i] & NOW) marks[i] |= BEFORE;
    this.before = Math.max(this.before, limit);
  }

  settle(): void {
    for (let i = 0; i < this.before; i++) this.marks[i] &= NOW;
    this.before = 0;
  }
}

export class Sorter {
  private centers = new Float32Array(0);
  private keys = new Uint32Array(0);
  private readonly counts = new Uint32Array((1 << BUCKET_BITS) + 1);
  private sides: [Marks, Marks | null] = [new Marks(0), null];

  reset(capacity: number): void {
    this.centers = new Float32Array(3 * capacity);
    this.keys = new Uint32Array(capacity);
    this.sides = [new Marks(capacity), null];
  }

  setCenters(first: number, centers: Float32Array): void {
    const room = Math.max(0, this.centers.length - 3 * first);
    this.centers.set(centers.subarray(0, room), 3 * first);
  }

  /** Mark the splats from `first` on that are drawn, none from `limit` on. */
  setDrawn(side: Side, first: number, drawn: Uint8Array, limit: number, fade = false): void {
    this.marksOf(side).set(first, drawn, limit, fade);
  }

  /** Draw splats from before a change no more. */
  settle(side: Side): void {
    this.sides[side]?.settle();
  }

  /** Give the memory of a side back. */
  drop(side: Side): void {
    if (side) this.sides[1] = null;
  }

  private marksOf(side: Side): Marks {
    return (this.sides[side] ??= new Marks(this.keys.length));
  }

  /**
   * Numbers of the splats that are drawn and lie at least `near` before the camera.
   *
   * `row` is the third row of world to camera [4]. Returns how many there are in `order`.
   */
  sort(side: Side, row: readonly number[], near: number, order: Uint32Array): number {
    const { centers, keys, counts } = this;
    const { marks, limit, before } = this.marksOf(side);
    const end = Math.max(limit, before);
    const [a, b, c, d] = row;
    const depth = new Float32Array(1);
    const bits = new Uint32Array(depth.buffer);
    let low = 0xffffffff;
    let high = 0;
    for (let i = 0; i < end; i++) {
      keys[i] = 0;
      if (!(i < limit ? marks[i] : marks[i] & BEFORE)) continue;
      depth[0] = a * centers[3 * i] + b * centers[3 * i + 1] + c * centers[3 * i + 2] + d;
      if (!(depth[0] >= near)) continue;
      const key = bits[0];
      keys[i] = key;
      if (key < low) low = key;
      if (key > high) high = key;
    }
    if (high === 0) return 0;
    let shift = 0;
    while ((high - low) >>> shift >= 1 << BUCKET_BITS) shift++;
    counts.fill(0);
    let total = 0;
    for (let i = 0; i < end; i++) {
      if (!keys[i]) continue;
      counts[(high - keys[i]) >>> shift]++;
      total++;
    }
    for (let bucket = 0, at = 0; bucket < counts.length; bucket++) {
      const count = counts[bucket];
      counts[bucket] = at;
      at += count;
    }
    for (let i = 0; i < end; i++) {
      if (keys[i]) order[counts[(high - keys[i]) >>> shift]++] = i;
    }
    return total;
  }
}
