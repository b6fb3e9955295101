// What the viewer's counter of frames says. node frames.mjs VIEWER_JS REQUEST_JSON: lists of times, ms.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [viewerPath, requestPath] = process.argv.slice(2);
const { FrameRate } = await import(pathToFileURL(viewerPath));
const said = JSON.parse(readFileSync(requestPath, "utf8")).map((times) => {
  const rate = new FrameRate();
  for (const time of times) rate.add(time);
  return rate.perSecond;
});
console.log(JSON.stringify(said));
