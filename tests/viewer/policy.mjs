// The viewer's policy functions on given cases. node policy.mjs VIEWER_JS REQUEST_JSON.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [viewerPath, requestPath] = process.argv.slice(2);
const { estimate, nextBlock, shares } = await import(pathToFileURL(viewerPath));
const { samples, boxes, eye, choices } = JSON.parse(readFileSync(requestPath, "utf8"));
const block = (parent, stored) => ({ parent, stored });
const directories = [[block(0, 9)], [block(0, 50), block(0, 50)], [block(0, 30), block(0, 30), block(1, 30), block(1, 30)]];
const share = [[1], [0, 1], [0, 0, 0.2, 0.8]];
const held = new Set(["0/0"]);
const order = [];
while (choices) {
  const next = nextBlock({
    directories,
    cap: 2,
    held: (level, number) => held.has(`${level}/${number}`),
    known: (level, number) => held.has(`${level}/${number}`),
    share: (level) => share[level],
  });
  if (!next) break;
  held.add(`${next.level}/${next.block}`);
  order.push(`${next.level}/${next.block}`);
}
const rates = samples.map((run) => estimate(run));
const found = eye ? [...shares(boxes, eye)] : [];
process.stdout.write(JSON.stringify({ rates, shares: found, choices: order }));
