// Open damaged copies of a file with the viewer's decoder; say of each whether it was refused.
// node mutate.mjs VIEWER_JS REQUEST_JSON: {file, cases: [[kind, place, value]]}.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [viewerPath, requestPath] = process.argv.slice(2);
const { ViewerError, readAll } = await import(pathToFileURL(viewerPath));
const { file, cases } = JSON.parse(readFileSync(requestPath, "utf8"));
const whole = new Uint8Array(readFileSync(file));
const answers = [];
for (const [kind, place, value] of cases) {
  let data = whole.slice();
  if (kind === "flip") data[place] ^= value;
  else if (kind === "cut") data = data.slice(0, place);
  else if (kind === "tail") data = Uint8Array.from([...data, ...new Array(place).fill(value)]);
  else if (kind === "zero") data.fill(0, place, place + value);
  else if (kind === "file") data = new Uint8Array(readFileSync(place));
  try {
    await readAll(data);
    answers.push("accepted");
  } catch (error) {
    answers.push(error instanceof ViewerError ? error.trouble : `CRASH ${error}`);
  }
}
process.stdout.write(JSON.stringify(answers));
