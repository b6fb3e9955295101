/** Blocks in the order of what they add for each byte, parents before children; as stream/viewed.py. */

import { SHARED } from "./catalog";
import type { State } from "./policy";

/** Blocks that come together: a block, and those on top of it that make it worth its bytes. */
interface Job {
  readonly value: number;
  readonly size: number;
  readonly items: readonly number[];
}

/** Some items in an order that can be used, and their value for each byte. */
interface Choice {
  readonly ratio: number;
  readonly items: readonly number[];
}

type Values = ReadonlyMap<number, number>;
const NOTHING: Choice = { ratio: -1, items: [] };

function ratioOf({ value, size }: Job): number {
  return value / Math.max(1, size);
}

/**
 * All blocks, those first that take most off the error of the pictures for their bytes.
 *
 * What blocks of a level share is paid for by all blocks that come because of it: a level is opened
 * when that, together with the best of its blocks, is worth more than what is open.
 */
export function ranked(state: State, values: Values): number[] {
  const { items, errors } = state.catalog;
  const known = new Set(state.known);
  const last = errors.length - 1;
  const order: number[] = [];
  let level = Math.max(0, ...[...known].filter((n) => items[n].block === SHARED).map((n) => items[n].level));
  while (level <= last) {
    const further: Choice[] = [];
    for (let up = level + 1; up <= last; up++) further.push(opened(state, values, known, level, up));
    const best = further.reduce((a, b) => (b.ratio > a.ratio ? b : a), NOTHING);
    let fresh = jobs(state, values, known, level).filter((job) => ratioOf(job) >= best.ratio).flatMap((job) => job.items);
    if (!fresh.length) {
      fresh = best.items.slice();
      level = further.length ? level + 1 + Math.max(0, further.indexOf(best)) : last + 1;
    }
    order.push(...fresh);
    for (const number of fresh) known.add(number);
  }
  return order;
}

/** The best to ask for next if the levels after `level`, up to `up`, are opened for it. */
function opened(state: State, values: Values, known: ReadonlySet<number>, level: number, up: number): Choice {
  const { items } = state.catalog;
  const found = items.flatMap((item, number) =>
    item.block === SHARED && item.level > level && item.level <= up && !known.has(number) ? [number] : []);
  let size = found.reduce((sum, number) => sum + items[number].size, 0);
  let gained = 0;
  let best = NOTHING.ratio;
  for (const job of jobs(state, values, known, up)) {
    gained += job.value;
    size += job.size;
    const ratio = gained / Math.max(1, size);
    if (ratio < best) break;
    best = ratio;
    found.push(...job.items);
  }
  return best < 0 ? NOTHING : { ratio: best, items: found };
}

/**
 * Missing blocks up to a level, best value for each byte first, parents before children.
 *
 * Horn's rule (1972) for jobs on one machine whose precedence is a forest: a job takes in the best of
 * those on top of it while that raises its ratio; then the order of ratios is the best.
 */
function jobs({ catalog }: State, values: Values, known: ReadonlySet<number>, up: number): Job[] {
  const { items } = catalog;
  const above = new Map<number, Job[]>();
  const roots: Job[] = [];
  for (let number = items.length - 1; number >= 0; number--) {
    const { level, size, needs } = items[number];
    const value = values.get(number);
    if (level > up || value === undefined || known.has(number)) continue;
    let job: Job = { value, size, items: [number] };
    const waiting = (above.get(number) ?? []).sort((a, b) => ratioOf(b) - ratioOf(a));
    above.delete(number);
    while (waiting.length && ratioOf(waiting[0]) > ratioOf(job)) {
      const top = waiting.shift()!;
      job = { value: job.value + top.value, size: job.size + top.size, items: [...job.items, ...top.items] };
    }
    const parent = needs.find((need) => items[need].level < level)!;
    // What was not taken in comes later than this job, and is worth less, so it may be free.
    if (known.has(parent) || !values.has(parent)) roots.push(job, ...waiting);
    else above.set(parent, [...(above.get(parent) ?? []), job, ...waiting]);
  }
  // Equal ratios keep the order of the file.
  return roots.sort((a, b) => ratioOf(b) - ratioOf(a) || a.items[0] - b.items[0]);
}
