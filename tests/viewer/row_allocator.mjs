// Blocks get rows and others lose theirs for them, at random. node row_allocator.mjs VIEWER_JS: prints what went wrong, as JSON.
import { pathToFileURL } from "node:url";

const { RowAllocator } = await import(pathToFileURL(process.argv[2]));
let state = 1;
const random = (n) => (state = (state * 48271) % 2147483647) % n;
const wrong = [];
const FIRST = 100, COUNT = 400;
let refused = 0, swapped = 0;
for (let run = 0; run < 30; run++) {
  const room = new RowAllocator(FIRST, COUNT);
  const rows = new Map();
  const costs = Array.from({ length: 200 }, () => (random(4) ? random(50) : Infinity));
  for (let owner = 0; owner < costs.length; owner++) {
    const count = random(60);
    const window = room.find(count, (other) => costs[other]);
    const cheapest = naive(rows, count, costs);
    if ((window?.cost ?? Infinity) !== cheapest) wrong.push(`cost ${window?.cost}, not ${cheapest}`);
    if (!window) {
      refused++;
      continue;
    }
    const { row, lost } = room.take(window, count, owner);
    for (const other of lost) if (!rows.delete(other)) wrong.push(`${other} was not there`);
    swapped += lost.length;
    if (row < FIRST || row + count > FIRST + COUNT) wrong.push(`${row} is outside`);
    for (const [other, { row: start, count: rest }] of rows) {
      if (row < start + rest && start < row + count) wrong.push(`${owner} lies on ${other}`);
    }
    rows.set(owner, { row, count });
  }
}
process.stdout.write(JSON.stringify({ wrong: wrong.slice(0, 5), refused, swapped }));

/** The least cost of rows side by side, tried at every row; a block without rows costs nothing where it lies. */
function naive(rows, count, costs) {
  const owners = new Array(COUNT).fill(-1);
  for (const [owner, { row, count: n }] of rows) owners.fill(owner, row - FIRST, row - FIRST + n);
  let best = Infinity;
  for (let at = 0; at + count <= COUNT; at++) {
    const hit = new Set(owners.slice(at, at + count).filter((owner) => owner >= 0));
    best = Math.min(best, [...hit].reduce((sum, owner) => sum + costs[owner], 0));
  }
  return best;
}
