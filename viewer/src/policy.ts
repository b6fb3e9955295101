/** What to ask for next: pure functions of a small state. */

import type { BlockRecord } from "./directory";

/** Half-lives of the two averages, seconds; the smaller average counts (dash.js). */
const FAST_SECONDS = 3;
const SLOW_SECONDS = 8;
/** Bytes per second before anything is measured: 500 kbit/s (hls.js). */
export const START_RATE = 62_500;
/** Less of the picture than this is not seen. */
export const SEEN = 1e-3;

/** Bytes that arrived within some seconds. */
export interface Sample {
  readonly amount: number;
  readonly seconds: number;
}

/** Throughput to count on, bytes per second, before the safety factor. */
export function estimate(samples: readonly Sample[]): number {
  if (!samples.length) return START_RATE;
  const averages = [FAST_SECONDS, SLOW_SECONDS].map((half) => {
    let value = 0;
    let weight = 0;
    for (const { amount, seconds } of samples) {
      const keep = 0.5 ** (seconds / half);
      value = keep * value + ((1 - keep) * amount) / seconds;
      weight = keep * weight + 1 - keep;
    }
    return value / weight;
  });
  return Math.min(...averages);
}

/** All that the choice of the next block looks at. */
export interface Choice {
  /** Directories by level; level 0 is held whole. */
  readonly directories: readonly (readonly BlockRecord[])[];
  /** Finest level wanted. */
  readonly cap: number;
  held(level: number, block: number): boolean;
  /** Held or under way. */
  known(level: number, block: number): boolean;
  /** Shares of the picture of the blocks of a level. */
  share(level: number): ArrayLike<number>;
}

/**
 * The next block: of the coarsest level that something seen lacks, the one with the largest share
 * of the picture per byte; what is not seen comes once all that is seen is there.
 *
 * Blocks whose parent is not held are left for later. Null if nothing can be asked for.
 */
export function nextBlock(choice: Choice): { level: number; block: number } | null {
  for (const seen of [true, false]) {
    for (let level = 1; level <= choice.cap; level++) {
      const block = bestOf(choice, level, seen);
      if (block >= 0) return { level, block };
    }
  }
  return null;
}

function bestOf(choice: Choice, level: number, seen: boolean): number {
  const share = seen ? choice.share(level) : null;
  let best = -1;
  let most = -1;
  choice.directories[level]?.forEach((record, block) => {
    if (choice.known(level, block)) return;
    if (!choice.held(level - 1, record.parent)) return;
    if (share && share[block] <= SEEN / choice.directories[level].length) return;
    const score = share ? share[block] / (record.stored + 1) : 0;
    if (score > most) {
      most = score;
      best = block;
    }
  });
  return best;
}
