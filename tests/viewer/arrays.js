// Every array that the viewer decodes from a file, by name: for node and for a page alike.

/** Scales of a splat, whose columns come before its other values. */
const SCALES = 3;

function valuesOf({ affine, tables: { block } }, table, before) {
  const columns = table.length / block.length;
  return Float32Array.from(table, (number, i) => {
    const at = 2 * (before + (i % columns));
    const [low, step] = affine[block[Math.floor(i / columns)]].subarray(at, at + 2);
    return low + step * number;
  });
}

/** `viewer` is its module; `eyes` are points from which all levels are decoded. */
export async function arraysOf(viewer, data, eyes, kernelName) {
  const { ListingDecoder, PlainKernel, SimdKernel, readAll } = viewer;
  const found = new Map();
  const assembler = await readAll(data);
  const { tables, index } = assembler;
  for (const name of ["lattice", "logScales", "codes", "residual", "slot", "owner", "offsets"]) {
    found.set(name, tables[name]);
  }
  // Of splats numbers are kept, with what they stand for by block.
  if (tables.block.length) {
    found.set("logScales", valuesOf(assembler, tables.logScales, 0));
    found.set("residual", valuesOf(assembler, tables.residual, SCALES));
  }
  // A splat is its own slot, of which tables say nothing.
  if (!tables.owner.length) {
    found.set("owner", Int32Array.from(tables.brought.keys()));
    found.set("slot", new Uint8Array(tables.brought.length));
  }
  assembler.grids.forEach((grid, part) => found.set(`grid ${part}`, grid));
  assembler.codebooks.forEach((book, level) => found.set(`codebook ${level}`, book));
  assembler.networks.forEach((networks, level) => {
    networks.forEach((weights, name) => found.set(`${name} ${level}`, weights));
  });
  const kernel = kernelName === "wasm" ? await SimdKernel.create() : new PlainKernel();
  const decoder = new ListingDecoder(assembler, kernel);
  for (const [e, eye] of eyes.entries()) {
    for (let level = 0; level < assembler.levelsReady; level++) {
      decoder.list(level, eye);
      found.set(`rows ${level} ${e}`, Uint32Array.from(decoder.rows));
      found.set(`values ${level} ${e}`, Float32Array.from(decoder.numbers));
      for (const { first, words } of decoder.takeRuns()) found.set(`words ${level} ${e} ${first}`, words);
    }
  }
  found.set("centers", decoder.centers(0, index.levels[assembler.levelsReady - 1]?.live ?? 0));
  return found;
}
