// Open many files with the viewer's decoder; say of each whether it was refused, and how.
// node verdicts.mjs VIEWER_JS FILES: each file as its length, u32, and its bytes.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [viewerPath, path] = process.argv.slice(2);
const { ViewerError, readAll } = await import(pathToFileURL(viewerPath));
const all = new Uint8Array(readFileSync(path));
const view = new DataView(all.buffer, all.byteOffset, all.byteLength);
const answers = [];
for (let at = 0; at < all.length; ) {
  const end = at + 4 + view.getUint32(at, true);
  try {
    await readAll(all.slice(at + 4, end));
    answers.push("accepted");
  } catch (error) {
    answers.push(error instanceof ViewerError ? error.trouble : `CRASH ${error}`);
  }
  at = end;
}
process.stdout.write(JSON.stringify(answers));
