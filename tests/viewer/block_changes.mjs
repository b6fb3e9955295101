// Blocks of splats come one by one, and what they change alone is decoded. node block_changes.mjs VIEWER_JS FILE: prints, as
// JSON, how often a splat was decoded, how many words differ from those of all decoded at once, both also where only the base and
// the last level are seen, and the pieces that looks from the same eye and from elsewhere give.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { Assembler, ListingDecoder, LevelView, PlainKernel } = await import(pathToFileURL(process.argv[2]));
const data = new Uint8Array(readFileSync(process.argv[3]));
const EYE = { position: [0.1, 0.2, 0.3] };
const FAR = { position: [40, 0.2, 0.3] };
const pause = () => Promise.resolve();

const shown = (words, at) => (words[at - (at % 8) + 7] >>> 16 ? words[at] : 0);
const put = (into, runs) => { for (const { first, words } of runs) into.set(words, 8 * first); };

/** Of a viewer that sees what each block changes, or that sees nothing between the first and the last. */
async function decodeAll(sees) {
  const assembler = new Assembler(data);
  for (const chunk of assembler.index.chunks) {
    if (chunk.kind !== 6) await assembler.add(chunk, data.subarray(chunk.offset, chunk.offset + chunk.stored));
  }
  const look = new LevelView(new ListingDecoder(assembler, new PlainKernel()), assembler, assembler.index.levels.length - 1);
  const present = new Uint32Array(8 * assembler.index.levels.at(-1).live);
  await look.decode(EYE, pause);
  const decode = async () => { put(present, (await look.decode(EYE, pause)).pieces); };
  for (const [level, blocks] of assembler.directories.entries()) {
    for (const [number, { offset, stored }] of blocks.entries()) {
      await assembler.addBlock(level, number, data.subarray(offset, offset + stored));
      look.addBlock(assembler.directories[level][number]);
      if (sees) look.showPassing();
      if (look.waits) await decode();
    }
  }
  look.showPassing();
  if (look.waits) await decode();
  const decoded = look.decoder.rows.length;
  const whole = new ListingDecoder(assembler, new PlainKernel());
  whole.list(look.cap, EYE.position);
  const expected = new Uint32Array(present.length);
  put(expected, whole.takeRuns());
  const wrong = expected.filter((_, at) => shown(expected, at) !== shown(present, at)).length;
  return { look, decoded, expected: whole.rows.length, wrong };
}

const { look, decoded, expected, wrong } = await decodeAll(true);
const { look: _, ...late } = await decodeAll(false);
const waits = [];
const pieces = [];
for (const [eye, exact] of [[EYE, false], [EYE, true], [FAR, true]]) {
  look.follow(eye, exact);
  waits.push(look.waits);
  pieces.push(look.waits ? (await look.decode(eye, pause)).pieces.length : 0);
}
process.stdout.write(JSON.stringify({ decoded, expected, wrong, late, waits, pieces }));
