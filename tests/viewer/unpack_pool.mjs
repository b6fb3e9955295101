// Blocks of a file unpacked by workers of which some break. node unpack_pool.mjs VIEWER_JS FILE: prints, for each number of
// workers that break, how many arrays differ from those unpacked here, as JSON.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { UnpackPool, readAll, serveUnpackPool, unpackBlock } = await import(pathToFileURL(process.argv[2]));
const data = new Uint8Array(readFileSync(process.argv[3]));
const { index, directories } = await readAll(data);
const found = [];
for (const broken of [0, 1, 2]) {
  let started = 0, ended = 0;
  globalThis.location = { href: "" };
  globalThis.Worker = class {
    number = started++;
    postMessage({ port, index }) {
      if (this.number >= broken) serveUnpackPool(port, index);
      // After it was given work, which it never does.
      else setTimeout(() => this.onerror({ preventDefault() {} }), 20);
    }
    terminate() { ended++; }
  };
  const pool = new UnpackPool(index, 2);
  const jobs = directories.flatMap((records, level) => records.map((record, number) => (
    { level, record, stored: data.subarray(record.offset, record.offset + record.stored), where: `${level}/${number}` })));
  const blocks = await Promise.all(jobs.map((job) => pool.unpack(job)));
  let differ = 0;
  for (const [number, job] of jobs.entries()) {
    const expected = await unpackBlock(job, index);
    for (const name in expected) differ += Buffer.compare(bytes(blocks[number][name]), bytes(expected[name])) !== 0;
  }
  const bad = { ...jobs[0], stored: jobs[0].stored.map((byte) => byte ^ 1) };
  const trouble = await pool.unpack(bad).then(() => "", (error) => error.trouble);
  found.push({ blocks: blocks.length, differ, trouble, ended, workers: pool.workers });
}
process.stdout.write(JSON.stringify(found), () => process.exit(0));

function bytes(array) {
  return Buffer.from(array.buffer, array.byteOffset, array.byteLength);
}
