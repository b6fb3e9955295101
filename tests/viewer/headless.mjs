// A level of a file by address, as plain Gaussians, in Node. node headless.mjs VIEWER_JS HEADLESS_JS FILE BAD LEVEL EYE.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [, , , headlessPath, file, bad, level, eye] = process.argv;
const { Decoding, SimdKernel, ViewerError, gaussiansOf, readAll } = await import(pathToFileURL(headlessPath));
const bytes = new Uint8Array(readFileSync(file));
const found = gaussiansOf(await readAll(bytes), await SimdKernel.create(), Number(level), JSON.parse(eye));
const refusal = await readAll(new Uint8Array(readFileSync(bad))).catch((error) => error instanceof ViewerError && error.trouble);
// And piece by piece, in the order in which a viewer would ask for them.
const events = await new Promise((resolve) => {
  const heard = [];
  const decoding = new Decoding({
    onmessage: null,
    postMessage: (message) => {
      heard.push(message.type === "level-ready" ? `level ${message.level}` : message.type);
      if (message.type === "complete" || message.type === "error") resolve(heard);
    },
  }, { type: "open", source: new Blob([bytes]), name: "", budget: 1e9, plain: false });
  const w2c = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
  decoding.take({ type: "view", eye: { w2c, position: JSON.parse(eye), right: 1, up: 1 }, serial: 0, now: true });
});
const arrays = Object.fromEntries(Object.entries(found).map(([name, values]) => [name, [...values]]));
// The loader waits for more to ask for, for ever.
process.stdout.write(JSON.stringify({ arrays, refusal, events, page: typeof document }), () => process.exit(0));
