/**
 * Our policy: the most expected viewed quality over the next seconds; as stream/lookahead.py.
 *
 * It imagines several whole orders in which the rest of the file could come, adds up for each the
 * quality of the pictures of the moments ahead while its items arrive, and takes the best.
 */

import { FULL_DB } from "./catalog";
import { SHARED } from "../format/directory";
import { rankBlocks } from "./schedule";
import { workingSet } from "./working-set";
import { SAFETY, SEEN, leafErrors, missing } from "./state";
import { estimateThroughput } from "./throughput";
import type { PolicyState } from "./state";

/** Seconds ahead up to which moments count: what is later is known too badly. */
export const HORIZON = 4;
/** Seconds that the last of these moments lasts. */
const TAIL = 1;
/** Moments of the middle window: now, in one and in two seconds. */
const NEAR_MOMENTS = 3;
/** Number of first items of the best order that are tried in front of it. */
const FORWARD = 4;
/** An order with another item in front must promise this share more: imagined quality is not so exact. */
const SOONER = 0.01;
/**
 * A sorted order must promise this share more than the best in which blocks come as in the file; the
 * second where the file does not say what its blocks add.
 */
const MARGIN = 0.01;
const GUESSED_MARGIN = 0.02;

type Shares = readonly ArrayLike<number>[];

/**
 * The items to request, those first that each needs, as far as they are weighed; none if nothing is missing. No moment of
 * the state is later than `HORIZON`.
 */
export function lookahead(whole: PolicyState): readonly number[] {
  const part = workingSet(whole);
  if (!part) return missing(whole, numbersOf(whole));
  const { state, numbers } = part;
  const order = bestOrder(state);
  return numbers ? order.map((number) => numbers[number]) : order;
}

function bestOrder(state: PolicyState): readonly number[] {
  const rate = SAFETY * estimateThroughput(state.samples);
  const errors = leafErrors(state);
  let best = -1;
  let chosen: readonly number[] = [];
  const weigh = (orders: readonly number[][], more: number): void => {
    for (const order of orders) {
      const value = viewedQuality(state, order, rate, errors);
      if (value <= best + more) continue;
      best = value;
      chosen = order;
    }
  };
  weigh(plainOrders(state), 1e-9);
  best *= 1 + (state.catalog.measured ? MARGIN : GUESSED_MARGIN);
  weigh(sortedOrders(state, errors), 0);
  best *= 1 + SOONER;
  weigh(promote(state, chosen), 0);
  return chosen;
}

/** Orders in which blocks of a level come as they lie in the file; none is empty. */
export function plainOrders(state: PolicyState): number[][] {
  const { items, errors } = state.catalog;
  const lacking = numbersOf(state).filter((number) => !state.known.has(number));
  const choices: number[][] = [[]];
  for (const share of [state.shares[0], meanOf(state.shares)]) {
    const seen = lacking.filter((number) => sumOver(share, items[number].region) > SEEN);
    for (let level = 0; level < errors.length; level++) {
      choices.push(seen.filter((number) => items[number].level <= level));
      choices.push(seen.filter((number) => items[number].level === level));
    }
  }
  return whole(state, choices);
}

/** Orders in which blocks come by what they add for each byte: now, within two seconds, and over all. */
export function sortedOrders(state: PolicyState, errors = leafErrors(state)): number[][] {
  const windows = [state.shares.slice(0, 1), state.shares.slice(0, NEAR_MOMENTS), state.shares];
  return whole(state, windows.map((shares) => rankBlocks(state, valuesOf(state, shares, errors))));
}

/**
 * The same order with another of its first items in front, if what that needs is there: ranked orders
 * do not know when a block will be seen.
 */
export function promote({ catalog }: PolicyState, order: readonly number[]): number[][] {
  const found: number[][] = [];
  for (let place = 1; place < Math.min(FORWARD, order.length); place++) {
    const before = order.slice(0, place);
    if (catalog.items[order[place]].needs.some((need) => before.includes(need))) continue;
    found.push([order[place], ...before, ...order.slice(place + 1)]);
  }
  return found;
}

/** Complete orders: the items that a choice lacks, then all others, needs first; none twice. */
function whole(state: PolicyState, choices: readonly number[][]): number[][] {
  const found = new Map<string, number[]>();
  const everything = missing(state, numbersOf(state));
  for (const goals of choices) {
    const first = new Set(missing(state, goals));
    const order = [...first, ...everything.filter((number) => !first.has(number))];
    if (order.length) found.set(order.join(), order);
  }
  return [...found.values()];
}

/** Reduction of the images' relative errors by each missing block, given its parent. */
function valuesOf({ catalog, known }: PolicyState, shares: Shares, errors: Float64Array): Map<number, number> {
  // What counts is decibels: a bad picture gains less from the same error taken away.
  const relative = shares.map((share) => {
    const error = Math.max(errors.reduce((sum, value, leaf) => sum + share[leaf] * value, 0), 1e-12);
    return Float64Array.from(share, (value) => value / error);
  });
  const share = meanOf(relative);
  const found = new Map<number, number>();
  catalog.items.forEach(({ level, block, region }, number) => {
    if (!level || block === SHARED || known.has(number)) return;
    const [above, own] = [catalog.errors[level - 1], catalog.errors[level]];
    let sum = 0;
    for (let i = 0; i < region.length; i++) sum += share[region[i]] * Math.max(above[region[i]] - own[region[i]], 0);
    found.set(number, sum);
  });
  return found;
}

/**
 * Decibel-seconds of the pictures ahead while an order arrives at `rate` bytes per second. Each
 * moment lasts until the next one, the last one for `TAIL`.
 */
export function viewedQuality({ catalog, shares, moments }: PolicyState, order: readonly number[], rate: number, errors: Float64Array): number {
  const now = errors.slice();
  const pictures = shares.map((share) => now.reduce((sum, error, leaf) => sum + share[leaf] * error, 0));
  const ends = moments.map((_, t) => (t + 1 < moments.length ? moments[t + 1] : moments[t] + TAIL));
  let total = 0;
  let begun = 0;
  const count = (until: number): void => {
    for (let t = 0; t < moments.length; t++) {
      const lasts = Math.min(until, ends[t]) - Math.max(begun, moments[t]);
      if (lasts > 0) total += lasts * decibels(pictures[t]);
    }
    begun = until;
  };
  let bytes = 0;
  for (const number of order) {
    const { level, size, region } = catalog.items[number];
    count((bytes += size) / rate);
    for (let i = 0; i < region.length; i++) {
      const leaf = region[i];
      const error = catalog.errors[level][leaf];
      if (error >= now[leaf]) continue;
      shares.forEach((share, t) => { pictures[t] -= share[leaf] * (now[leaf] - error); });
      now[leaf] = error;
    }
  }
  count(Infinity);
  return total;
}

/** PSNR against the full model, dB, from 0 to `FULL_DB`. */
function decibels(error: number): number {
  return Math.min(FULL_DB, Math.max(0, -10 * Math.log10(Math.max(error, 1e-12))));
}

function numbersOf({ catalog }: PolicyState): number[] {
  return catalog.items.map((_, number) => number);
}

function sumOver(share: ArrayLike<number>, region: ArrayLike<number>): number {
  let sum = 0;
  for (let i = 0; i < region.length; i++) sum += share[region[i]];
  return sum;
}

function meanOf(shares: Shares): Float64Array {
  return Float64Array.from(shares[0], (_, leaf) => shares.reduce((sum, share) => sum + share[leaf], 0) / shares.length);
}
