/** One side of the picture on the page's thread: its attributes' way to the GPU, and its draw order. */

import type { TrainingFocals } from "../format/notes/training-focals";
import type { FromDecoder, SceneFacts, Side, Sorted, ToSorter } from "../decode/messages";
import { freeMemory } from "../base/free-memory";
import { SLOTS_PER_MESSAGE, WORDS } from "../decode/pack-attributes";
import { NEAR, ROW } from "./shaders";
import type { UploadRange } from "./upload-queue";

type Changes = Extract<FromDecoder, { type: "attributes" }>;

/** Attributes and draw order of one side's splats where they are drawn: a `Layer`, or what an engine draws. */
export interface SplatLayer {
  limit: number;
  focals: TrainingFocals | null;
  /** True while the textures of a change are held. */
  readonly changing: boolean;
  /** Attributes of splats from `first` on, see `packSlot`. */
  setAttributes(first: number, words: Uint32Array): void;
  /** Give numbers from … to of the next order, which counts once all `count` are there. */
  setOrder(order: Uint32Array, from: number, to: number, count: number): void;
  keep(first: number, count: number, time: number, fade: number): void;
  settle(): void;
}

/** Holder of the layers of both sides. */
export interface Surface {
  /** Seconds over which looks change; at 0 nothing is kept. */
  readonly fade: number;
  layer(side: Side): SplatLayer;
  /** Call for so many splats, in parts, in the order of the calls; for those of an `order` apart: see `UploadQueue`. */
  later(side: Side, count: number, give: UploadRange, order?: boolean): void;
}

export class SideView {
  /** Splats in the last order. */
  drawn = 0;
  /** Serial of the view or level that the order follows. */
  sortedFor = -1;
  /** Serial of the view or level that the last attributes follow; -1 before any came. */
  shown = -1;
  private fadeUntil = 0;
  sorting = false;
  private resort = false;
  private spare: Uint32Array | null;

  constructor(
    readonly side: Side,
    /** Tells orders of this pane from those of one before it. */
    readonly epoch: number,
    private readonly capacity: number,
    /** Third row of world to camera [4] for the next picture: asked for at each sort, since a camera at rest tells nobody. */
    private readonly row: () => readonly number[],
    private readonly tell: (message: ToSorter, transfer?: Transferable[]) => void,
    /** True while no picture would show an order. */
    private readonly idles = () => false,
  ) {
    this.spare = new Uint32Array(Math.ceil(capacity / ROW) * ROW);
  }

  /** True once all attributes are sorted and no change is under way. */
  isSettled(now: number): boolean {
    return !this.sorting && !this.resort && !this.isFading(now);
  }

  isFading(now: number): boolean {
    return now < this.fadeUntil;
  }

  take({ pieces, limit, focals, serial, fade }: Changes, surface: Surface, now: () => number): void {
    const { side } = this;
    const layer = surface.layer(side);
    const mix = fade && surface.fade > 0;
    // A level that shows other splats changes all, one block only its own pages.
    let all = false;
    const keep = (first: number, count: number) => {
      // From a page's first splat on.
      const before = first % SLOTS_PER_MESSAGE;
      layer.keep(first - before, count + before, now(), surface.fade);
      this.fadeUntil = now() + surface.fade;
    };
    surface.later(side, 0, () => {
      all = limit !== layer.limit;
      if (mix && all) keep(0, this.capacity);
      layer.limit = limit;
      layer.focals = focals;
    });
    for (const { first, words, drawn } of pieces) {
      surface.later(side, drawn.length, (from, to) => {
        if (mix && !all) keep(first + from, to - from);
        layer.setAttributes(first + from, words.subarray(WORDS * from, WORDS * to));
        if (to === drawn.length) freeMemory(words);
      });
    }
    surface.later(side, 0, () => {
      let first = mix;
      for (const piece of pieces.length ? pieces : [{ first: 0, drawn: new Uint8Array(0) }]) {
        this.tell({ type: "drawn", side, first: piece.first, drawn: piece.drawn, limit, fade: first }, [piece.drawn.buffer]);
        first = false;
      }
      this.shown = serial;
      this.sort();
    });
  }

  /** Sort for the camera of the next picture. */
  sort(): void {
    const { side, epoch, spare, shown } = this;
    if (this.sorting || !spare || this.idles()) {
      this.resort = true;
      return;
    }
    this.sorting = true;
    this.resort = false;
    this.spare = null;
    this.tell({ type: "sort", side, epoch, row: this.row(), near: NEAR, serial: shown, spare }, [spare.buffer]);
  }

  /** Draw in another order; `done` is called when it is drawn. */
  takeOrder({ order, count, serial }: Sorted, surface: Surface, done: () => void): void {
    const layer = surface.layer(this.side);
    surface.later(this.side, count, (from, to) => {
      layer.setOrder(order, from, to, count);
      if (to < count) return;
      this.spare = order;
      this.drawn = count;
      this.sorting = false;
      this.sortedFor = serial;
      if (this.resort) this.sort();
      done();
    }, true);
  }

  /** Sort what waits to be, and give back what a change needed, once it is over. */
  tidy(surface: Surface, now: number): void {
    if (this.resort) this.sort();
    if (this.isFading(now) || !surface.layer(this.side).changing) return;
    surface.layer(this.side).settle();
    this.tell({ type: "settle", side: this.side });
    this.sort();
  }
}

/** Splats of a level that are held at once, in whole pages. */
export function capacityOf(facts: SceneFacts, level: number): number {
  return Math.ceil(Math.min(facts.room, facts.levels[level].live) / SLOTS_PER_MESSAGE + 1) * SLOTS_PER_MESSAGE;
}

/** Splats of a scene that has a capacity at most. */
export function roomWithin(capacity: number): number {
  return capacity - SLOTS_PER_MESSAGE;
}
