/** Splats as tables in memory, for engines that own their textures: rows of `ROW` texels as in `Renderer`. */

import type { TrainingFocals } from "../format/notes/training-focals";
import type { Side } from "../decode/messages";
import { WORDS } from "../decode/pack-attributes";
import type { SplatLayer, Surface } from "../render/side";
import { ROW } from "../render/shaders";
import type { UploadRange } from "../render/upload-queue";

/** Texels of a splat's attributes, and values of a texel of centres or attributes. */
const TEXELS = 2;
const CHANNELS = 4;

/** One level's splats; what has changed is told by rows, so that an engine uploads no more. */
export class SplatTables implements Surface, SplatLayer {
  /** Looks change at once. */
  readonly fade = 0;
  readonly changing = false;
  readonly centers: Float32Array<ArrayBuffer>; // [rows · ROW, 4] world units, the last one unused
  readonly words: Uint32Array<ArrayBuffer>; // [2 · rows · ROW, 4] see `packSlot`
  readonly order: Uint32Array<ArrayBuffer>; // [rows · ROW] far to near
  /** Splats in the order. */
  count = 0;
  limit = 0;
  focals: TrainingFocals | null = null;
  private changed = { centers: new Set<number>(), words: new Set<number>(), order: false };

  /** Room for so many splats, none of them drawn. */
  constructor(capacity: number) {
    this.rows = Math.max(1, Math.ceil(capacity / ROW));
    this.centers = new Float32Array(CHANNELS * ROW * this.rows);
    this.words = new Uint32Array(CHANNELS * TEXELS * ROW * this.rows);
    this.order = new Uint32Array(ROW * this.rows);
  }

  /** Rows of `centers` and of `order`; `words` has twice as many. */
  readonly rows: number;

  layer(): SplatLayer {
    return this;
  }

  /** Centres of splats from `first` on, [n, 3] world units. */
  setCenters(first: number, centers: Float32Array): void {
    const count = Math.min(centers.length / 3, ROW * this.rows - first);
    for (let i = 0; i < count; i++) {
      for (let axis = 0; axis < 3; axis++) this.centers[CHANNELS * (first + i) + axis] = centers[3 * i + axis];
    }
    mark(this.changed.centers, first, count);
  }

  /** Memory takes all at once. */
  later(_side: Side, count: number, give: UploadRange): void {
    give(0, count);
  }

  setAttributes(first: number, words: Uint32Array): void {
    const held = words.subarray(0, Math.max(0, this.words.length - WORDS * first));
    this.words.set(held, WORDS * first);
    mark(this.changed.words, TEXELS * first, held.length / CHANNELS);
  }

  setOrder(order: Uint32Array, from: number, to: number, count: number): void {
    this.count = Math.min(count, this.order.length);
    this.order.set(order.subarray(from, Math.min(to, this.count)), from);
    this.changed.order = true;
  }

  /** Rows that changed since the last call, and whether the order did. */
  takeChanges(): { centers: readonly number[]; words: readonly number[]; order: boolean } {
    const { centers, words, order } = this.changed;
    this.changed = { centers: new Set(), words: new Set(), order: false };
    return { centers: [...centers], words: [...words], order };
  }

  /** Nothing fades, so nothing is kept. */
  keep(): void { /* */ }

  settle(): void { /* */ }
}

/** Rows in which texels first … first + count lie. */
function mark(rows: Set<number>, first: number, count: number): void {
  for (let row = Math.floor(first / ROW); row * ROW < first + count; row++) rows.add(row);
}
