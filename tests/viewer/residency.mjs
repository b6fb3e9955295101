// Blocks come into a scene larger than its budget and others go for them, as pictures need them. node residency.mjs
// VIEWER_JS FILE: prints, after each change of what is looked at, how many slots are not drawn as without a budget, as JSON.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { Assembler, Decoder, LevelView, PlainKernel, Residency, catalogOf, dropBlock } = await import(pathToFileURL(process.argv[2]));
const data = new Uint8Array(readFileSync(process.argv[3]));
const EYE = { position: [0.1, 0.2, 0.3] };
let state = 1;
const random = () => (state = (state * 48271) % 2147483647) / 2147483647;

/** All but blocks of levels after the first. */
async function opened(room) {
  const assembler = new Assembler(data);
  assembler.room = room;
  for (const chunk of assembler.index.chunks) {
    if (chunk.kind !== 6) await assembler.add(chunk, data.subarray(chunk.offset, chunk.offset + chunk.stored));
  }
  for (const number of assembler.directories[0].keys()) await add(assembler, 0, number);
  return assembler;
}

async function add(assembler, level, number) {
  const { offset, stored } = assembler.directories[level][number];
  await assembler.addBlock(level, number, data.subarray(offset, offset + stored));
}

/** What a page has of a look after all that was decoded, 8 words a slot. */
const pages = new Map();

async function decode(look) {
  const { pieces } = await look.decode(EYE, () => Promise.resolve());
  if (!pages.has(look)) pages.set(look, new Uint32Array(8 * whole.index.levels.at(-1).live + 8192));
  for (const { first, words } of pieces) pages.get(look).set(words, 8 * first);
}

/** What is drawn of an assembler: centre and attributes of each splat, without their order. */
async function drawn(assembler, look, cap) {
  const decoder = look.decoder;
  look.cap = cap;
  look.refreshAll();
  await decode(look);
  const count = assembler.tables.brought.length;
  const centers = decoder.centers(0, count);
  const limit = assembler.room < Infinity ? count : assembler.index.levels[cap].live;
  const found = [];
  for (let row = 0; row < limit; row++) {
    const words = pages.get(look).subarray(8 * row, 8 * row + 8);
    if (words[7] >>> 16) found.push(`${centers.subarray(3 * row, 3 * row + 3)} ${words}`);
  }
  return found.sort();
}

const whole = await opened(Infinity);
const last = whole.index.levels.length - 1;
const room = Math.round(0.44 * whole.index.levels[last].live);
const small = await opened(room);
const bounded = new Residency(small);
const catalog = catalogOf(small, last + 1);
const look = new LevelView(new Decoder(small, new PlainKernel()), small, last);
const isHeld = (number) => small.hasBlock(catalog.items[number].level, catalog.items[number].block);
const report = [];
for (let turn = 0; turn < 6; turn++) {
  const worth = Float64Array.from(catalog.items, () => random() ** 4);
  let [changes, lost] = [0, 0];
  for (let found; changes < 300 && (found = bounded.next({ items: catalog.items, worth }, last + 1, isHeld)); changes++) {
    for (const number of found.lost) {
      const { level, block } = catalog.items[number];
      dropBlock(small, level, block);
      look.dropBlock(level, small.directories[level][block]);
      lost++;
    }
    const { level, block } = catalog.items[found.number];
    await add(small, level, block);
    look.addBlock(small.directories[level][block]);
    // What is stale is decoded now and then, not all at once.
    if (changes % 3 === 0) await decode(look);
  }
  const twin = await opened(Infinity);
  for (let level = 1; level <= last; level++) for (const number of small.held[level]) await add(twin, level, number);
  const twinLook = new LevelView(new Decoder(twin, new PlainKernel()), twin, last);
  for (const cap of [last, last - 1, 0]) {
    const [own, other] = [await drawn(small, look, cap), await drawn(twin, twinLook, cap)];
    const set = new Set(other);
    report.push({ changes, lost, drawn: own.length, expected: other.length, wrong: own.filter((each) => !set.has(each)).length });
  }
}
process.stdout.write(JSON.stringify(report));
