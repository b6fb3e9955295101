/**
 * Our policy: the most expected viewed quality over the next seconds; as stream/viewed.py.
 *
 * It imagines several whole orders in which the rest of the file could come, adds up for each the
 * quality of the pictures of the moments ahead while its items arrive, and asks for the first item of
 * the best.
 */

import { FULL_DB } from "./catalog";
import { SAFETY, SEEN, drawable, estimate, leafErrors, missing } from "./policy";
import type { State } from "./policy";

/** Seconds that the last moment ahead goes on counting. */
const TAIL = 5;
/** A sorted order must promise this share more than the best in which blocks come as in the file. */
const MARGIN = 0.02;

type Shares = readonly ArrayLike<number>[];

/** The next item to ask for; null to ask for nothing. What it needs is held or under way. */
export function ours(state: State): number | null {
  const rate = SAFETY * estimate(state.samples);
  const errors = leafErrors(state);
  let best = -1;
  let chosen: number | null = null;
  const weigh = (orders: readonly number[][], more: number): void => {
    for (const order of orders) {
      const value = viewedQuality(state, order, rate, errors);
      if (value <= best + more) continue;
      best = value;
      chosen = order[0];
    }
  };
  weigh(plainOrders(state), 1e-9);
  best *= 1 + MARGIN;
  weigh(sortedOrders(state, errors), 0);
  return chosen;
}

/** Orders in which blocks of a level come as they lie in the file; none is empty. */
export function plainOrders(state: State): number[][] {
  const { items, errors } = state.catalog;
  const all = items.map((_, number) => number);
  const choices = [all];
  for (const share of [state.shares[0], meanOf(state.shares)]) {
    const seen = all.filter((number) => sumOver(share, items[number].region) > SEEN);
    for (let level = 0; level < errors.length; level++) {
      choices.push([...seen.filter((number) => items[number].level <= level), ...all]);
      choices.push([...seen.filter((number) => items[number].level === level), ...all]);
    }
  }
  return whole(state, choices);
}

/**
 * Orders in which blocks of a level come by what they add for each byte; none is empty: level after
 * level, region after region to the finest level, and levels by the gain of all that they lack.
 */
export function sortedOrders(state: State, errors = leafErrors(state)): number[][] {
  const { items } = state.catalog;
  const choices: number[][] = [];
  for (const shares of [state.shares.slice(0, 1), state.shares]) {
    const value = gains(state, shares, errors);
    const keys = [...value.keys()].sort((a, b) => value.get(b)! - value.get(a)!);
    choices.push(keys.slice().sort((a, b) => items[a].level - items[b].level), keys, byBundle(state, value, keys));
  }
  return whole(state, choices);
}

/** What each choice lacks, needs first, as far as the device can draw it; none twice. */
function whole(state: State, choices: readonly number[][]): number[][] {
  const found = new Map<string, number[]>();
  for (const goals of choices) {
    const order = drawable(state, missing(state, goals));
    if (order.length) found.set(order.join(), order);
  }
  return [...found.values()];
}

/** What each missing item takes off the error of the pictures, for each of its own bytes. */
function gains({ catalog, known }: State, shares: Shares, errors: Float64Array): Map<number, number> {
  const share = meanOf(shares);
  const found = new Map<number, number>();
  catalog.items.forEach(({ level, size, region }, number) => {
    if (known.has(number)) return;
    let sum = 0;
    for (let i = 0; i < region.length; i++) sum += share[region[i]] * Math.max(errors[region[i]] - catalog.errors[level], 0);
    found.set(number, sum / Math.max(1, size));
  });
  return found;
}

/** Levels by the gain per byte of all their seen blocks together with what these lack. */
function byBundle(state: State, value: ReadonlyMap<number, number>, ranked: readonly number[]): number[] {
  const { items, errors } = state.catalog;
  const scores = errors.map((_, level) => {
    const seen = ranked.filter((number) => items[number].level === level && value.get(number)! > 0);
    const size = missing(state, seen).reduce((sum, number) => sum + items[number].size, 0);
    const gain = seen.reduce((sum, number) => sum + value.get(number)! * items[number].size, 0);
    return size ? gain / size : 0;
  });
  return ranked.slice().sort((a, b) => scores[items[b].level] - scores[items[a].level]);
}

/**
 * Decibel-seconds of the pictures ahead while an order arrives at `rate` bytes per second. Each
 * moment lasts until the next one, the last one for `TAIL`.
 */
export function viewedQuality({ catalog, shares, moments }: State, order: readonly number[], rate: number, errors: Float64Array): number {
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
    const error = catalog.errors[level];
    for (let i = 0; i < region.length; i++) {
      const leaf = region[i];
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

function sumOver(share: ArrayLike<number>, region: ArrayLike<number>): number {
  let sum = 0;
  for (let i = 0; i < region.length; i++) sum += share[region[i]];
  return sum;
}

function meanOf(shares: Shares): Float64Array {
  return Float64Array.from(shares[0], (_, leaf) => shares.reduce((sum, share) => sum + share[leaf], 0) / shares.length);
}
