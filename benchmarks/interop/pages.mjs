// Splats drawn by programs that are not ours, in Chromium. node pages.mjs REQUEST_JSON:
// {chromium, folder, out, jobs}; a job is {name, engine, url, format, camera}. Each picture goes to OUT/NAME.png; what is
// known of all comes as JSON: {name: {count, seconds}} or {name: {error}}.
import { createServer } from "node:http";
import { createReadStream, readFileSync, statSync, writeFileSync } from "node:fs";
import { dirname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { chromium } from "playwright-core";

const HERE = dirname(fileURLToPath(import.meta.url));
const TYPES = { js: "text/javascript", mjs: "text/javascript", json: "application/json", wasm: "application/wasm", html: "text/html" };
/** Pictures alike, ms between them, ms until one gives up, characters of a picture that is not black. */
const STEADY = 2, PAUSE = 250, PATIENCE = 120_000, LEAST = 4000;
const request = JSON.parse(readFileSync(process.argv[2], "utf8"));

for (const engine of new Set(request.jobs.map((job) => job.engine))) {
  await build({
    entryPoints: [join(HERE, "pages", `${engine}.js`)], outfile: join(request.out, `${engine}.js`),
    bundle: true, format: "esm", logLevel: "error", nodePaths: [join(HERE, "node_modules")],
  });
}

/** Files of the folder, the bundles, and the packages that a program fetches by itself. */
const server = createServer((asked, answer) => {
  const path = normalize(decodeURIComponent(asked.url.split("?")[0]));
  const [, top, ...rest] = path.split("/");
  const roots = { files: request.folder, bundles: request.out, packages: join(HERE, "node_modules") };
  if (top === "page") {
    const { width, height } = request.jobs[0].camera;
    answer.setHeader("content-type", "text/html");
    answer.end(`<!doctype html><body style="margin:0;background:#000"><canvas width=${width} height=${height} style="display:block;width:${width}px;height:${height}px"></canvas><script type=module src=/bundles/${rest[0]}.js></script>`);
    return;
  }
  try {
    const file = join(roots[top], ...rest);
    answer.setHeader("content-length", statSync(file).size);
    answer.setHeader("content-type", TYPES[file.split(".").pop()] ?? "application/octet-stream");
    createReadStream(file).pipe(answer);
  } catch {
    answer.writeHead(404).end();
  }
});
await new Promise((done) => { server.listen(0, "127.0.0.1", done); });
const address = `http://127.0.0.1:${server.address().port}`;

const browser = await chromium.launch({
  executablePath: request.chromium,
  args: ["--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-quic", "--disable-background-networking"],
});
const results = {};
for (const job of request.jobs) {
  const { width, height } = job.camera;
  const page = await browser.newPage({ viewport: { width, height } });
  const said = [];
  page.on("console", (message) => { if (message.type() === "error") said.push(message.text()); });
  page.on("pageerror", (error) => said.push(error.message));
  try {
    results[job.name] = await drawn(page, job);
  } catch (error) {
    results[job.name] = { error: [error.message.split("\n")[0], ...said].join("; ").slice(0, 300) };
  }
  process.stderr.write(`${job.name} ${JSON.stringify(results[job.name])}\n`);
  await page.close();
}
await browser.close();
server.close();
process.stdout.write(JSON.stringify(results));

/** The picture once it stays as it is, not black. */
async function drawn(page, job) {
  const begin = Date.now();
  await page.goto(`${address}/page/${job.engine}`);
  await page.waitForFunction("globalThis.draw");
  const asked = { ...job, url: `${address}/files/${job.url}`, spz: `${address}/packages/@adobe/spz/dist/spz.js` };
  const found = await Promise.race([
    page.evaluate((job) => globalThis.draw(job), asked),
    new Promise((_, refuse) => { setTimeout(() => refuse(new Error("not loaded in time")), PATIENCE); }),
  ]);
  const loaded = Date.now();
  let last = "", same = 0;
  while (same < STEADY) {
    if (Date.now() > loaded + PATIENCE) throw new Error("the picture never stays");
    await page.waitForTimeout(PAUSE);
    const now = await page.evaluate(() => globalThis.frame());
    same = now === last && now.length > LEAST ? same + 1 : 0;
    last = now;
  }
  writeFileSync(`${request.out}/${job.name}.png`, Buffer.from(last.split(",")[1], "base64"));
  const count = found.count ?? (await page.evaluate(() => globalThis.count()));
  return { count, seconds: (loaded - begin) / 1000 };
}
