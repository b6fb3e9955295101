// The viewer's policy functions on given cases. node policy.mjs VIEWER_JS REQUEST_JSON:
// {samples, boxes, eye, motion, cases, states, gains, runs, files, asked}; see test_policy.py for what each part asks.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [viewerPath, requestPath] = process.argv.slice(2);
const { Assembler, HORIZON, ViewPrediction, catalogOf, coalesce, coverage, estimateThroughput, extrapolate, lookahead, missing, parseBlockUtility, sortedOrders, viewedQuality } = await import(pathToFileURL(viewerPath));
const request = JSON.parse(readFileSync(requestPath, "utf8"));

/** A state of tests/stream/cases.py, items named by their numbers. */
function stateOf({ items, errors, table, leaves, held, samples, shares, moments }) {
  const numbers = new Map(items.map(({ key }, number) => [key.join(), number]));
  const numbersOf = (keys) => keys.map((key) => numbers.get(key.join()));
  const catalog = {
    items: items.map(({ key, size, needs, region, slots }) => ({ level: key[0], block: key[1], size, needs: numbersOf(needs), region, slots })),
    errors: table?.map((row) => Float64Array.from(row)) ?? errors.map((error) => new Float64Array(leaves).fill(error)),
    measured: Boolean(table),
    leaves,
  };
  const state = { catalog, known: new Set(numbersOf(held)), samples, shares, moments };
  return { state, numbersOf, keyOf: (number) => (number === null ? null : items[number].key) };
}

/** The first item that the policy asks for, of a state whose later moments do not count. */
function chosen(state) {
  const count = Math.max(1, state.moments.filter((moment) => moment <= HORIZON).length);
  const within = { ...state, shares: state.shares.slice(0, count), moments: state.moments.slice(0, count) };
  return lookahead(within).at(0) ?? null;
}

/** Errors of leaves in a state, worked out anew. */
function errorsOf({ catalog, known }) {
  return Float64Array.from({ length: catalog.leaves }, (_, leaf) => {
    const levels = [...known].map((n) => catalog.items[n]).filter((item) => item.region.includes(leaf)).map((item) => item.level);
    return levels.length ? catalog.errors[Math.max(...levels)][leaf] : 1;
  });
}

function played(content) {
  const { state, keyOf } = stateOf(content);
  const known = new Set(state.known);
  const order = [];
  for (;;) {
    const next = chosen({ ...state, known });
    if (next === null) return order;
    if (known.has(next) || order.length > state.catalog.items.length) return "asked twice";
    if (!state.catalog.items[next].needs.every((need) => known.has(need))) return "needs come later";
    known.add(next);
    order.push(keyOf(next));
  }
}

const answers = (request.cases ?? []).map(({ state: content, orders }) => {
  const { state, numbersOf, keyOf } = stateOf(content);
  const values = orders.map(([order]) => viewedQuality(state, numbersOf(order), request.rate, errorsOf(state)));
  return { choice: keyOf(chosen(state)), values, played: played(content) };
});
const lists = (request.states ?? []).map(({ content, goals, order, rate }) => {
  const { state, numbersOf, keyOf } = stateOf(content);
  const lacks = missing(state, numbersOf(goals));
  const value = viewedQuality(state, numbersOf(order), rate, errorsOf(state));
  const sorted = sortedOrders(state).map((found) => found.map(keyOf));
  return { missing: lacks.map(keyOf), value, sorted, ours: keyOf(chosen(state)) };
});
const rates = (request.samples ?? []).map((run) => estimateThroughput(run));
const found = request.eye ? [...coverage(request.boxes, request.eye)] : [];
const ahead = request.motion ? extrapolate(...request.motion) : [];
const gains = (request.gains ?? []).map(({ text, blocks }) => parseBlockUtility(text, blocks)?.map((level) => [...level]) ?? null);
const runs = (request.runs ?? []).map(({ items, number, known, rate }) => coalesce({ items }, number, new Set(known), rate));

/** An assembler of a file that knows its directories alone. */
async function opened(path) {
  const data = new Uint8Array(readFileSync(path));
  const assembler = new Assembler(data.subarray(0, 16384));
  const [manifest, directory] = [1, 2];
  for (const chunk of assembler.index.chunks) {
    const wanted = chunk.kind === manifest || chunk.kind === directory;
    if (wanted) await assembler.add(chunk, data.subarray(chunk.offset, chunk.offset + chunk.stored));
  }
  return assembler;
}

/** Items of a file's catalog. */
async function itemsOf(path) {
  const assembler = await opened(path);
  return catalogOf(assembler, assembler.index.levels.length).items.map((item) => ({ ...item, region: [...item.region] }));
}

/** The order in which blocks of a file are asked for, and how often the clock was read for each, which ticks once each time. */
async function asked(path) {
  const assembler = await opened(path);
  const prediction = new ViewPrediction(assembler);
  const { now } = performance;
  let ticks = 0;
  performance.now = () => ticks++;
  const known = new Set(["0/-1"]);
  const found = [];
  for (;;) {
    const before = ticks;
    const items = prediction.next(assembler.index.levels.length, { samples: [], lineRate: 1 }, (level, block) => known.has(`${level}/${block}`));
    if (!items.length) break;
    for (const { level, block } of items) known.add(`${level}/${block}`);
    found.push({ items: items.map(({ level, block }) => [level, block]), ticks: ticks - before });
  }
  performance.now = now;
  return found;
}
const catalogs = await Promise.all((request.files ?? []).map(itemsOf));
const orders = await Promise.all((request.asked ?? []).map(asked));
process.stdout.write(JSON.stringify({ catalogs, orders, gains, runs, rates, shares: found, ahead, answers, lists }));
