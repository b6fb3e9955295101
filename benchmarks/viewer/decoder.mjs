// Times of the viewer's decoder under node, one thread, as a worker has it.
// npm --prefix viewer run split standalone && node benchmarks/viewer/decoder.mjs FILE.gsyn [REPEATS]
// Prints CSV: level, anchors, slots, parse ms (bytes to tables, level's own part), decode ms (all
// anchors of the level to Gaussians), view ms (heads again for another eye), by kernel; medians.
import { readFileSync } from "node:fs";
import { cpus } from "node:os";

const { Assembler, Decoder, PlainKernel, SimdKernel } = await import("../../viewer/dist/gsynopsis-viewer.js");
const [file, repeats = "5"] = process.argv.slice(2);
const data = new Uint8Array(readFileSync(file));
const median = (list) => list.sort((a, b) => a - b)[list.length >> 1];
const BLOCKS = 6;
const rows = new Map();

function note(level, name, ms) {
  const key = `${level} ${name}`;
  rows.set(key, [...(rows.get(key) ?? []), ms]);
}

async function once(name) {
  const assembler = new Assembler(data);
  const { index } = assembler;
  const kernel = name === "wasm" ? await SimdKernel.create() : new PlainKernel();
  const decoder = new Decoder(assembler, kernel);
  const eye = [index.header.center_x, index.header.center_y, index.header.center_z - index.header.extent];
  for (const level of index.levels.keys()) {
    let begun = performance.now();
    for (const chunk of index.chunks) {
      if (chunk.level !== level) continue;
      if (chunk.kind !== BLOCKS) {
        await assembler.add(chunk, data.subarray(chunk.offset, chunk.offset + chunk.stored));
        continue;
      }
      for (const [b, { offset, stored }] of assembler.directories[level].entries()) {
        await assembler.addBlock(level, b, data.subarray(offset, offset + stored));
      }
    }
    note(level, `parse ${name}`, performance.now() - begun);
    begun = performance.now();
    for (const _ of decoder.refresh(level, eye));
    decoder.centers(0, index.levels[level].live);
    note(level, `decode ${name}`, performance.now() - begun);
    begun = performance.now();
    for (const _ of decoder.refresh(level, eye.map((v) => v * 1.1)));
    note(level, `view ${name}`, performance.now() - begun);
  }
  return assembler;
}

const kinds = ["wasm", "plain"];
let assembler;
for (let i = 0; i < Number(repeats); i++) for (const kind of kinds) assembler = await once(kind);
console.log(`# ${cpus()[0].model}, node ${process.version}, ${file.split("/").pop()}, median of ${repeats}`);
const names = kinds.flatMap((kind) => ["parse", "decode", "view"].map((what) => `${what} ${kind}`));
console.log(["level", "end_bytes", "anchors", "slots", ...names.map((n) => `${n.replace(" ", "_")}_ms`)].join());
for (const [level, entry] of assembler.index.levels.entries()) {
  const times = names.map((name) => median(rows.get(`${level} ${name}`)).toFixed(1));
  console.log([level, entry.end, entry.anchors, entry.live, ...times].join());
}
