// Decode files with the viewer's own code and write every array, for Python to compare.
// node dump.mjs VIEWER_JS REQUEST_JSON: {files, eyes, kernel, out}.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [viewerPath, requestPath] = process.argv.slice(2);
const { Decoder, PlainKernel, SimdKernel, readAll } = await import(pathToFileURL(viewerPath));
const request = JSON.parse(readFileSync(requestPath, "utf8"));
const arrays = [];
const pieces = [];
let length = 0;

function give(file, name, array) {
  const bytes = Buffer.from(array.buffer, array.byteOffset, array.byteLength);
  arrays.push({ file, name, type: array.constructor.name, start: length, count: array.length });
  pieces.push(bytes);
  length += bytes.length;
}

for (const [number, path] of request.files.entries()) {
  const assembler = await readAll(new Uint8Array(readFileSync(path)));
  const { tables, index } = assembler;
  for (const name of ["lattice", "logScales", "codes", "residual", "slot", "owner", "offsets"]) {
    give(number, name, tables[name]);
  }
  assembler.grids.forEach((grid, part) => give(number, `grid ${part}`, grid));
  assembler.codebooks.forEach((book, level) => give(number, `codebook ${level}`, book));
  assembler.networks.forEach((networks, level) => {
    networks.forEach((weights, name) => give(number, `${name} ${level}`, weights));
  });
  const kernel = request.kernel === "wasm" ? await SimdKernel.create() : new PlainKernel();
  const decoder = new Decoder(assembler, kernel);
  for (const [e, eye] of request.eyes.entries()) {
    for (let level = 0; level < assembler.levelsReady; level++) {
      const rows = [];
      const values = [];
      decoder.listen((row, array, at) => {
        rows.push(row);
        values.push(...array.subarray(at, at + 11));
      });
      for (const _ of decoder.refresh(level, eye));
      give(number, `rows ${level} ${e}`, Uint32Array.from(rows));
      give(number, `values ${level} ${e}`, Float32Array.from(values));
      give(number, `words ${level} ${e}`, decoder.words.slice());
    }
  }
  give(number, "centers", decoder.centers(0, index.levels[assembler.levelsReady - 1]?.live ?? 0));
}
writeFileSync(request.out, Buffer.concat(pieces));
process.stdout.write(JSON.stringify(arrays));
