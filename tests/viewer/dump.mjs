// Decode files with the viewer's own code and write every array, for Python to compare.
// node dump.mjs VIEWER_JS REQUEST_JSON: {files, eyes, kernel, out}.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { arraysOf } from "./arrays.js";

const [viewerPath, requestPath] = process.argv.slice(2);
const viewer = await import(pathToFileURL(viewerPath));
const request = JSON.parse(readFileSync(requestPath, "utf8"));
const arrays = [];
const pieces = [];
let length = 0;

for (const [file, path] of request.files.entries()) {
  const found = await arraysOf(viewer, new Uint8Array(readFileSync(path)), request.eyes, request.kernel);
  for (const [name, array] of found) {
    const bytes = Buffer.from(array.buffer, array.byteOffset, array.byteLength);
    arrays.push({ file, name, type: array.constructor.name, start: length, count: array.length });
    pieces.push(bytes);
    length += bytes.length;
  }
}
writeFileSync(request.out, Buffer.concat(pieces));
process.stdout.write(JSON.stringify(arrays));
