/** The part of a large file that a choice is made from: the regions that the views ahead show most; as stream/working_set.py. */

import type { Item } from "./catalog";
import { SHARED } from "../format/directory";
import { leafErrors } from "./state";
import type { PolicyState } from "./state";

/** Items up to which all are weighed. */
const MANY = 1024;
/** Else those of so many leaves. */
const WINDOW = 192;

/** A state of some items only, and their numbers in the whole one; null where it is the whole one. */
export interface WorkingSet {
  readonly state: PolicyState;
  readonly numbers: readonly number[] | null;
}

/**
 * The state of the leaves that matter most; of all where there are not `MANY` items. All other leaves
 * are one more, which nothing improves. Null where no item lacks that shows anything.
 */
export function workingSet(state: PolicyState): WorkingSet | null {
  const { catalog: { items, errors, leaves, measured }, known, shares } = state;
  if (items.length <= MANY) return { state, numbers: null };
  const chosen = topLeaves(state);
  if (!chosen.length) return null;
  const places = new Int32Array(leaves).fill(-1);
  chosen.forEach((leaf, place) => { places[leaf] = place; });
  const others = chosen.length;
  const numbers: number[] = [];
  const regions: ArrayLike<number>[] = [];
  items.forEach(({ level, block, region }, number) => {
    const own = level === 0 && block === SHARED ? Array.from({ length: others + 1 }, (_, place) => place) : placesIn(region, places);
    if (!own.length && block !== SHARED) return;
    numbers.push(number);
    regions.push(own);
  });
  const part = new Map(numbers.map((number, at) => [number, at]));
  const error = errorOfOthers(state, places);
  const rows = shares.map((share) => {
    const row = new Float64Array(others + 1);
    chosen.forEach((leaf, place) => { row[place] = share[leaf]; });
    row[others] = Math.max(0, 1 - row.reduce((sum, value) => sum + value, 0));
    return row;
  });
  const own: Item[] = numbers.map((number, at) => ({ ...items[number], region: regions[at], needs: items[number].needs.flatMap((need) => part.get(need) ?? []) }));
  const table = errors.map((row) => Float64Array.from([...chosen, -1], (leaf) => (leaf < 0 ? error : row[leaf])));
  const held = new Set([...known].flatMap((number) => part.get(number) ?? []));
  const catalog = { items: own, errors: table, measured, leaves: others + 1 };
  return { state: { ...state, catalog, known: held, shares: rows }, numbers };
}

/** The leaves that lack something and take most of a picture, at most `WINDOW`, ascending. */
function topLeaves({ catalog: { items, leaves }, known, shares }: PolicyState): number[] {
  const lacking = new Uint8Array(leaves);
  items.forEach(({ region }, number) => {
    if (known.has(number)) return;
    for (let i = 0; i < region.length; i++) lacking[region[i]] = 1;
  });
  const found: number[] = [];
  const worth = new Float64Array(leaves);
  lacking.forEach((lacks, leaf) => {
    if (!lacks) return;
    found.push(leaf);
    for (const share of shares) worth[leaf] = Math.max(worth[leaf], share[leaf]);
  });
  return found.sort((a, b) => worth[b] - worth[a] || a - b).slice(0, WINDOW).sort((a, b) => a - b);
}

function placesIn(region: ArrayLike<number>, places: Int32Array): number[] {
  const found: number[] = [];
  for (let i = 0; i < region.length; i++) if (places[region[i]] >= 0) found.push(places[region[i]]);
  return found;
}

/** Mean error of the leaves left out, by what they take of the pictures. */
function errorOfOthers(state: PolicyState, places: Int32Array): number {
  const errors = leafErrors(state);
  let [sum, total] = [0, 0];
  errors.forEach((error, leaf) => {
    if (places[leaf] >= 0) return;
    for (const share of state.shares) {
      sum += (share[leaf] * error) / state.shares.length;
      total += share[leaf] / state.shares.length;
    }
  });
  return sum / Math.max(total, 1e-12);
}
