// In a worker of its own: the seconds to read all tables of FILE and to decode its finest level from
// nothing, REPEATS times. MODULE, FILE and REPEATS are put before this text.
const { Assembler, Decoder, SimdKernel } = await import(MODULE);
const data = new Uint8Array(await (await fetch(FILE)).arrayBuffer());
const BLOCKS = 6;
const found = { read: [], decode: [], view: [] };
for (let i = 0; i < REPEATS; i++) {
  let begun = performance.now();
  const assembler = new Assembler(data);
  const { index } = assembler;
  for (const chunk of index.chunks) {
    if (chunk.kind !== BLOCKS) {
      await assembler.add(chunk, data.subarray(chunk.offset, chunk.offset + chunk.stored));
      continue;
    }
    for (const [b, { offset, stored }] of assembler.directories[chunk.level].entries()) {
      await assembler.addBlock(chunk.level, b, data.subarray(offset, offset + stored));
    }
  }
  const note = (name) => {
    found[name].push((performance.now() - begun) / 1000);
    begun = performance.now();
  };
  note("read");
  const decoder = new Decoder(assembler, await SimdKernel.create());
  const last = index.levels.length - 1;
  const { header } = index;
  const eye = [header.center_x, header.center_y, header.center_z - header.extent];
  begun = performance.now();
  for (const _ of decoder.refresh(last, eye));
  note("decode");
  for (const _ of decoder.refresh(last, eye.map((v) => 1.1 * v)));
  note("view");
}
postMessage(found);
