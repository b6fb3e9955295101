/** Input of a policy, and the helpers that all policies share; as stream/policy.py. */

import type { Catalog } from "./catalog";
import type { Sample } from "./throughput";

/** Share of the estimated throughput that is counted on (dash.js). */
export const SAFETY = 0.9;
/** Share of the image below which a region counts as unseen. */
export const SEEN = 1e-3;

/** All that a policy may look at. */
export interface PolicyState {
  readonly catalog: Catalog;
  /** Items that are complete or under way. */
  readonly known: ReadonlySet<number>;
  /** Measurements of throughput, oldest first. */
  readonly samples: readonly Sample[];
  /** Share of the picture of each leaf at each moment ahead; the first is now. */
  readonly shares: readonly ArrayLike<number>[];
  /** Moments of `shares`, seconds from now. */
  readonly moments: readonly number[];
}

/** Missing items of the goals that are not under way, needs before the items that need them. */
export function missing({ catalog, known }: PolicyState, goals: Iterable<number>): number[] {
  const order: number[] = [];
  const seen = new Set(known);
  const visit = (item: number): void => {
    if (seen.has(item)) return;
    seen.add(item);
    for (const need of catalog.items[item].needs) visit(need);
    order.push(item);
  };
  for (const goal of goals) visit(goal);
  return order;
}

/** Error of each leaf at the level it has or will have; 1 where there is nothing. */
export function leafErrors({ catalog, known }: PolicyState): Float64Array {
  const levels = new Int32Array(catalog.leaves).fill(-1);
  for (const number of known) {
    const { level, region } = catalog.items[number];
    for (let i = 0; i < region.length; i++) levels[region[i]] = Math.max(levels[region[i]], level);
  }
  return Float64Array.from(levels, (level, leaf) => (level < 0 ? 1 : catalog.errors[level][leaf]));
}
