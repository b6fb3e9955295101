/** Prediction of the views ahead, and the policy's choice of the next items for them. */

import type { Assembler } from "../format/assembler";
import { UNKNOWN, catalogOf, leavesOf } from "./catalog";
import type { Catalog, Item, Leaves } from "./catalog";
import type { ViewPose } from "../base/view-pose";
import { estimateThroughput } from "./throughput";
import type { Sample } from "./throughput";
import { RUN_SECONDS, coalesce } from "./coalesce";
import { HORIZON, lookahead } from "./lookahead";
import { LEAK, coverageOver, extrapolate } from "./visibility";

/** Moments ahead at which the policy sees the picture, seconds. */
const AHEAD = Array.from({ length: HORIZON + 1 }, (_, second) => second);
/** Seconds without a new view after which the camera counts as resting. */
const REST = 0.3;
/** Longest request, bytes: what comes in `RUN_SECONDS` over a fast line. */
const REQUEST_BYTES = 192 * 1024;

/** An order stands for so many times what it took to find: to choose takes at most a tenth of the worker's time. */
const STANDS = 9;

/** Share of the image below which a page counts as unseen. */
const SEEN = 1e-3;

/** Blocks, and how much each takes off the errors of the views ahead. */
export interface BlockUtilities {
  readonly items: readonly Item[];
  readonly worth: Float64Array;
}

/** A connection: samples of what came and was used, and bytes per second of the line, 0 or not a number where nobody tells. */
export interface Line {
  readonly samples: readonly Sample[];
  readonly lineRate: number;
}

export class ViewPrediction {
  private leaves: Leaves;
  private readonly catalogs = new Map<number, Catalog>();
  private last: { eye: ViewPose; time: number; before: ViewPose; step: number } | null = null;
  private shares: { readonly resting: boolean; readonly rows: readonly Float64Array[] } | null = null;
  /** The order in which the rest of a catalog is to come, and when it is to be chosen anew, milliseconds. */
  private plan: { readonly catalog: Catalog; readonly order: readonly number[]; readonly until: number } | null = null;

  constructor(private readonly assembler: Assembler) {
    this.leaves = leavesOf(assembler);
  }

  /** A page of a directory has come. */
  learn(): void {
    this.leaves = leavesOf(this.assembler);
    this.catalogs.clear();
    this.shares = null;
  }

  /**
   * The page, of so many levels, of which the pictures ahead show most, as level and number: one whose blocks divide one
   * that is held. Else, if all are wanted, any; null if there is none.
   */
  page(levels: number, all: boolean, isKnown: (level: number, page: number) => boolean): readonly [number, number] | null {
    const { assembler, leaves: { lineage, boxes } } = this;
    const { pages } = assembler;
    if (!pages) return null;
    const rows = this.sharesNow();
    const found = new Map<string, { readonly at: readonly [number, number]; readonly shares: number[] }>();
    boxes.forEach((_, leaf) => {
      const level = lineage.findIndex((blocks) => blocks[leaf] === UNKNOWN);
      if (level < 1 || level >= levels) return;
      const parent = lineage[level - 1][leaf];
      const page = pages.pageUnder(level, parent);
      if (isKnown(level, page) || !(all || assembler.hasBlock(level - 1, parent))) return;
      const name = `${level}/${page}`;
      let entry = found.get(name);
      if (!entry) found.set(name, (entry = { at: [level, page], shares: rows.map(() => 0) }));
      // What is shared out among all regions tells nothing of one of them.
      rows.forEach((row, t) => { entry.shares[t] += row[leaf] - LEAK / boxes.length; });
    });
    let best: readonly [number, number] | null = null;
    let most = all ? -1 : SEEN;
    for (const { at, shares } of found.values()) {
      const share = Math.max(...shares);
      if (share > most) [best, most] = [at, share];
    }
    return best;
  }

  /** The camera is here at a time, seconds. */
  look(eye: ViewPose, time: number): void {
    const { last } = this;
    const step = last ? time - last.time : 0;
    const moves = last !== null && step > 0 && step < REST;
    this.last = { eye, time, before: moves ? last.eye : eye, step: moves ? step : 1 };
    this.shares = null;
  }

  /**
   * The next items of so many levels, side by side in the file; none if all is there or under way.
   *
   * What is chosen depends on how fast bytes are used, and how many are requested at once on the line alone: a decoder
   * that is slower than the line gains nothing by small requests.
   */
  next(levels: number, { samples, lineRate }: Line, isKnown: (level: number, block: number) => boolean): Item[] {
    const catalog = this.catalogFor(levels);
    const known = new Set<number>();
    catalog.items.forEach(({ level, block }, number) => {
      if (isKnown(level, block)) known.add(number);
    });
    if (known.size === catalog.items.length) return [];
    const found = this.choose(catalog, known, samples);
    const rate = Math.min(lineRate || estimateThroughput(samples), REQUEST_BYTES / RUN_SECONDS);
    return coalesce(catalog, found, known, rate).map((number) => catalog.items[number]);
  }

  /** The next of the items that lack, by the order that stands or by one that is chosen now. */
  private choose(catalog: Catalog, known: ReadonlySet<number>, samples: readonly Sample[]): number {
    const begun = performance.now();
    const next = () => this.plan?.order.find((number) => !known.has(number));
    if (this.plan?.catalog !== catalog || begun > this.plan.until || next() === undefined) {
      const order = lookahead({ catalog, known, samples, shares: this.sharesNow(), moments: AHEAD });
      const now = performance.now();
      this.plan = { catalog, order, until: now + STANDS * (now - begun) };
    }
    return next()!;
  }

  /** Utility of all blocks of the file, held or not. */
  worth(): BlockUtilities {
    const { items, errors } = this.catalogFor(this.assembler.directories.length);
    const rows = this.sharesNow();
    const share = rows[0].map((_, leaf) => rows.reduce((sum, row) => sum + row[leaf], 0));
    const worth = Float64Array.from(items, ({ level, region }) => {
      let sum = 0;
      for (let i = 0; level && i < region.length; i++) {
        sum += share[region[i]] * Math.max(errors[level - 1][region[i]] - errors[level][region[i]], 0);
      }
      return sum;
    });
    return { items, worth };
  }

  private catalogFor(levels: number): Catalog {
    let catalog = this.catalogs.get(levels);
    if (!catalog) this.catalogs.set(levels, (catalog = catalogOf(this.assembler, levels)));
    return catalog;
  }

  private sharesNow(): readonly Float64Array[] {
    const { last, leaves: { boxes } } = this;
    if (!last) return AHEAD.map(() => new Float64Array(boxes.length).fill(1 / boxes.length));
    const resting = last.before === last.eye || performance.now() / 1000 - last.time > REST;
    if (this.shares?.resting !== resting) {
      const eyes = resting ? AHEAD.map(() => last.eye) : extrapolate(last.before, last.eye, last.step, AHEAD);
      this.shares = { resting, rows: coverageOver(boxes, eyes) };
    }
    return this.shares.rows;
  }
}
