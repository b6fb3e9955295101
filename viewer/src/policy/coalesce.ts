/** Items joined into one request, since small requests would wait for round trips; as stream/coalesce.py. */

import type { Catalog } from "./catalog";

/** Items side by side in the file are one request if together they take no longer, seconds. */
export const RUN_SECONDS = 0.05;
/** Seconds to the end of a download from which on requests may be longer and leave no gaps. */
const ENDING = 0.5;
const ENDING_RUN = 0.1;

/**
 * An item, and its neighbours in the file that come in no time along with it: those behind it; in the
 * end also those before it. In the order of the file; `rate` is in bytes per second.
 */
export function coalesce({ items }: Pick<Catalog, "items">, number: number, known: ReadonlySet<number>, rate: number): number[] {
  const lacks = items.reduce((sum, { size }, other) => (known.has(other) ? sum : sum + size), 0);
  const ending = lacks <= ENDING * rate;
  let room = rate * (ending ? ENDING_RUN : RUN_SECONDS) - items[number].size;
  const run = [number];
  const joins = (other: number): boolean => {
    const { start, size } = items[other];
    const last = items[run[run.length - 1]];
    const adjoins = start === last.start + last.size || start + size === items[run[0]].start;
    if (known.has(other) || size > room || !adjoins) return false;
    room -= size;
    return true;
  };
  // Items without bytes lie nowhere.
  const order = items.map((_, other) => other).filter((other) => items[other].size || other === number);
  const place = order.indexOf(number);
  for (const other of order.slice(place + 1)) {
    if (!joins(other)) break;
    run.push(other);
  }
  for (const other of ending ? order.slice(0, place).reverse() : []) {
    if (!joins(other)) break;
    run.unshift(other);
  }
  return run;
}
