/** Blocks in the order of what they add for each byte, parents before children; as stream/lookahead.py. */

import { SHARED } from "../format/directory";
import type { PolicyState } from "./state";

/** Blocks that come together: a block, and those on top of it that make it worth its bytes. */
interface Job {
  readonly value: number;
  readonly size: number;
  /** Value for each byte. */
  readonly ratio: number;
  readonly items: readonly number[];
}

/** Some items in an order that can be used, and their value for each byte. */
interface Choice {
  readonly ratio: number;
  readonly items: readonly number[];
}

/** The missing blocks up to some level. */
interface Forest {
  /** The parent of each, by the block's number. */
  readonly parents: ReadonlyMap<number, number>;
  /** Each block's jobs and those of what lies on it, best value for each byte first. */
  readonly jobs: readonly { readonly block: number; readonly job: Job }[];
}

type Values = ReadonlyMap<number, number>;
const NOTHING: Choice = { ratio: -1, items: [] };

function jobOf(value: number, size: number, items: readonly number[]): Job {
  return { value, size, ratio: value / Math.max(1, size), items };
}

/**
 * All blocks, those first that take most off the error of the pictures for their bytes.
 *
 * The shared part of a level is paid for by all blocks that come because of it: a level is opened
 * when that, together with the best of its blocks, is worth more than what is open.
 */
export function rankBlocks(state: PolicyState, values: Values): number[] {
  const { items, errors } = state.catalog;
  const known = new Set(state.known);
  const last = errors.length - 1;
  const order: number[] = [];
  let level = Math.max(0, ...[...known].filter((n) => items[n].block === SHARED).map((n) => items[n].level));
  const forests = errors.map((_, up) => forestOf(state, values, up));
  while (level <= last) {
    const openings: Choice[] = [];
    for (let up = level + 1; up <= last; up++) openings.push(openLevels(state, forests[up], known, level, up));
    const best = openings.reduce((a, b) => (b.ratio > a.ratio ? b : a), NOTHING);
    let fresh = jobsOf(forests[level], known).filter((job) => job.ratio >= best.ratio).flatMap((job) => job.items);
    if (!fresh.length) {
      fresh = best.items.slice();
      level = openings.length ? level + 1 + Math.max(0, openings.indexOf(best)) : last + 1;
    }
    order.push(...fresh);
    for (const number of fresh) known.add(number);
  }
  return order;
}

/** The best to ask for next if the levels after `level`, up to `up`, are opened for it. */
function openLevels(state: PolicyState, forest: Forest, known: ReadonlySet<number>, level: number, up: number): Choice {
  const { items } = state.catalog;
  const found = items.flatMap((item, number) =>
    item.block === SHARED && item.level > level && item.level <= up && !known.has(number) ? [number] : []);
  let size = found.reduce((sum, number) => sum + items[number].size, 0);
  let gained = 0;
  let best = NOTHING.ratio;
  for (const job of jobsOf(forest, known)) {
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
 * The jobs of missing blocks up to a level; the children of a missing block are missing too.
 *
 * Horn's rule (1972) for jobs on one machine whose precedence is a forest: a job takes in the best of
 * those on top of it while that raises its ratio; then the order of ratios is the best.
 */
function forestOf({ catalog }: PolicyState, values: Values, up: number): Forest {
  const { items } = catalog;
  const parents = new Map<number, number>();
  const jobs: { block: number; job: Job }[] = [];
  const above = new Map<number, Job[]>();
  for (let number = items.length - 1; number >= 0; number--) {
    const { level, size, needs } = items[number];
    const value = values.get(number);
    if (level > up || value === undefined) continue;
    let job = jobOf(value, size, [number]);
    const waiting = (above.get(number) ?? []).sort((a, b) => b.ratio - a.ratio);
    above.delete(number);
    while (waiting.length && waiting[0].ratio > job.ratio) {
      const top = waiting.shift()!;
      job = jobOf(job.value + top.value, job.size + top.size, [...job.items, ...top.items]);
    }
    // What was not taken in comes later than this job, and is worth less, so it may be free.
    const own = [job, ...waiting];
    const parent = needs.find((need) => items[need].level < level)!;
    parents.set(number, parent);
    for (const one of own) jobs.push({ block: number, job: one });
    const beside = above.get(parent);
    if (beside) beside.push(...own);
    else above.set(parent, own.slice());
  }
  // Equal ratios keep the order of the file.
  jobs.sort(({ job: a }, { job: b }) => b.ratio - a.ratio || a.items[0] - b.items[0]);
  return { parents, jobs };
}

/** All jobs of missing blocks, best value for each byte first, parents before children. */
function jobsOf({ parents, jobs }: Forest, known: ReadonlySet<number>): Job[] {
  const found: Job[] = [];
  for (const { block, job } of jobs) {
    const parent = parents.get(block)!;
    if (!known.has(block) && (known.has(parent) || !parents.has(parent))) found.push(job);
  }
  return found;
}
