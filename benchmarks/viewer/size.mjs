// One viewer while it loads and while a camera flies. node size.mjs REQUEST_JSON: {chromium, interop (a folder with
// node_modules and pages), files, folder, out, job}; the job is {name, engine, url, format, width, height, fov, frames,
// patience, paths, and for ours a tour of [position, target] with a rest at each}. What is found comes as JSON: count, seconds to the first picture, until all is loaded, and until the
// picture stands still, milliseconds of frames, triangles and camera of the last one by path, peak memory.
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { createReadStream, readFileSync, readdirSync, statSync, writeFileSync } from "node:fs";
import { join, normalize } from "node:path";

const request = JSON.parse(readFileSync(process.argv[2], "utf8"));
const { job } = request;
const { width, height, fov } = job;
const packages = createRequire(join(request.interop, "package.json"));
const { chromium } = packages("playwright-core");
const MEMORY_EVERY = 500;
/** Milliseconds at each stop of a tour. */
const REST = 6000;

const address = job.engine === "ours" ? "" : await serve();
const browser = await chromium.launchServer({
  executablePath: request.chromium,
  args: ["--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-quic", "--disable-background-networking"],
});
const peak = { pss: 0, last: 0, gpu: 0, samples: 0 };
const watch = setInterval(() => { sample(browser.process().pid); }, MEMORY_EVERY);
const said = [];
try {
  const page = await (await chromium.connect(browser.wsEndpoint())).newPage({ viewport: { width, height } });
  page.on("console", (message) => { if (message.type() === "error") said.push(message.text()); });
  page.on("pageerror", (error) => said.push(error.message));
  await page.addInitScript(prepare, { ...job });
  const begun = Date.now();
  await page.goto(job.engine === "ours" ? job.url : `${address}/page`);
  if (job.engine !== "ours") {
    await page.waitForFunction("globalThis.draw", null, { polling: 20 });
    // Not awaited: it ends when all is loaded.
    await page.evaluate(({ job, url }) => {
      globalThis.draw({ ...job, url, usual: true, camera: globalThis.cameraAt("around", 0) })
        .then(({ count }) => { globalThis.loaded = { count, at: Date.now() }; }, (error) => { globalThis.refused = String(error); });
    }, { job, url: `${address}/files/${job.url}` });
  }
  await until(page, "globalThis.loaded", "never all loaded");
  await until(page, "globalThis.isStill()", "its picture never stood still");
  const { first, changed, loaded } = await page.evaluate("globalThis.found()");
  const found = { count: loaded.count, first_s: (first - begun) / 1000, loaded_s: (loaded.at - begun) / 1000, all_s: (changed - begun) / 1000 };
  for (const path of job.paths) {
    const { frames, triangles, camera } = await page.evaluate(({ path, frames }) => globalThis.fly(path, frames), { path, frames: job.frames });
    found[path] = frames;
    found[`${path}_triangles`] = triangles;
    found[`${path}_camera`] = camera;
    if (request.out) writeFileSync(`${request.out}/${job.name}_${path}.png`, await page.screenshot({ timeout: job.patience }));
  }
  found.tour = [];
  for (const [position, target] of job.tour ?? []) {
    await page.evaluate((camera) => { document.querySelector("gsynopsis-viewer").camera = camera; }, { position, target, fov });
    await page.waitForTimeout(REST);
    const { splats } = await page.evaluate("document.querySelector('gsynopsis-viewer').stats");
    found.tour.push({ splats, pss_mib: peak.last / 1024 });
  }
  found.drawn = job.engine !== "ours" ? loaded.count : await page.evaluate("document.querySelector('gsynopsis-viewer').stats.splats");
  clearInterval(watch);
  process.stdout.write(JSON.stringify({ ...found, peak_mib: peak.pss / 1024, gpu_mib: peak.gpu / 1024, samples: peak.samples, said }));
} catch (error) {
  process.stdout.write(JSON.stringify({ error: [error.message.split("\n")[0], ...said].join("; ").slice(0, 300), peak_mib: peak.pss / 1024 }));
} finally {
  clearInterval(watch);
  await browser.close();
  process.exit(0);
}

async function until(page, script, waited) {
  const end = Date.now() + job.patience;
  while (!(await page.evaluate(script))) {
    const refused = await page.evaluate("globalThis.refused");
    if (refused || Date.now() > end) throw new Error(refused ?? waited);
    await page.waitForTimeout(100);
  }
}

/** Proportional set size of the browser and all that it started, KiB; that of the process that draws beside it. */
function sample(root) {
  const parents = new Map();
  for (const name of readdirSync("/proc")) {
    if (!/^\d+$/.test(name)) continue;
    try {
      parents.set(Number(name), Number(readFileSync(`/proc/${name}/stat`, "utf8").split(") ").pop().split(" ")[1]));
    } catch { /* it has ended */ }
  }
  let pss = 0;
  for (const pid of parents.keys()) {
    let up = pid;
    while (up > 1 && up !== root) up = parents.get(up) ?? 0;
    if (up !== root) continue;
    try {
      const own = Number(/^Pss:\s+(\d+)/m.exec(readFileSync(`/proc/${pid}/smaps_rollup`, "utf8"))[1]);
      pss += own;
      if (readFileSync(`/proc/${pid}/cmdline`, "utf8").includes("--type=gpu-process")) peak.gpu = Math.max(peak.gpu, own);
    } catch { /* it has ended */ }
  }
  peak.last = pss;
  peak.pss = Math.max(peak.pss, pss);
  peak.samples++;
}

/** A page for an engine that is not ours. */
async function serve() {
  const { build } = packages("esbuild");
  const bundle = join(request.folder, `${job.engine}.js`);
  await build({
    entryPoints: [join(request.interop, "pages", `${job.engine}.js`)], outfile: bundle,
    bundle: true, format: "esm", logLevel: "error", nodePaths: [join(request.interop, "node_modules")],
  });
  const server = createServer((asked, answer) => {
    const path = normalize(decodeURIComponent(asked.url.split("?")[0]));
    const send = (type, file) => {
      answer.setHeader("content-type", type);
      answer.setHeader("content-length", statSync(file).size);
      createReadStream(file).pipe(answer);
    };
    if (path === "/bundle.js") send("text/javascript", bundle);
    else if (path.startsWith("/files/")) send("application/octet-stream", join(request.files, path.slice(7)));
    else if (path === "/page") {
      answer.setHeader("content-type", "text/html");
      answer.end(`<!doctype html><link rel=icon href=data:,><body style="margin:0;background:#000"><canvas width=${width} height=${height} style="display:block;width:${width}px;height:${height}px"></canvas><script type=module src=/bundle.js></script>`);
    } else answer.writeHead(404).end();
  });
  await new Promise((done) => { server.listen(0, "127.0.0.1", done); });
  return `http://127.0.0.1:${server.address().port}`;
}

/** Runs in the page before all else: watches what is drawn; cameras of a path, and a flight along it. */
function prepare({ engine, width, height, fov }) {
  /** Share of the pixels that a first picture lights; milliseconds after the last change in which it is taken to stand. */
  const LEAST = 0.02, QUIET = 3000;
  // Of each call the triangles, by the places of its count and its instances.
  const PLACES = { drawElements: [1], drawArrays: [2], drawElementsInstanced: [1, 4], drawArraysInstanced: [2, 3] };
  let triangles = 0;
  const seen = { first: 0, changed: 0, frames: 0, sum: -1 };
  let watching = true, asked = false;
  const pixels = new Uint8Array(4 * width * height);
  const measure = (gl) => {
    asked = false;
    const bound = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
    let lit = 0, sum = 0;
    for (let i = 0; i < pixels.length; i += 4) {
      const value = pixels[i] + 256 * pixels[i + 1] + 65536 * pixels[i + 2];
      lit += pixels[i] + pixels[i + 1] + pixels[i + 2] > 24;
      sum = (Math.imul(sum, 31) + value) | 0;
    }
    const now = Date.now();
    if (lit < LEAST * width * height) return;
    seen.first ||= now;
    seen.frames++;
    if (sum !== seen.sum) Object.assign(seen, { sum, changed: now });
  };
  // What draws onto the canvas is read in the same task, when all of the frame is drawn.
  for (const [name, [count, instances]] of Object.entries(PLACES)) {
    const draw = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function drawn(...options) {
      draw.apply(this, options);
      triangles += (options[count] / 3) * (options[instances] ?? 1);
      if (!watching || asked || this.drawingBufferWidth < width || this.getParameter(this.DRAW_FRAMEBUFFER_BINDING)) return;
      asked = true;
      queueMicrotask(() => { measure(this); });
    };
  }
  globalThis.isStill = () => seen.first > 0 && Date.now() - Math.max(seen.changed, globalThis.loaded.at) > QUIET;
  globalThis.found = () => {
    watching = false;
    return { ...seen, loaded: globalThis.loaded };
  };

  const viewer = () => document.querySelector("gsynopsis-viewer");
  addEventListener("complete", ({ detail }) => { if (detail) globalThis.loaded = { count: viewer().levels.at(-1).anchors, at: Date.now() }; });
  addEventListener("viewer-error", ({ detail }) => { globalThis.refused = detail.message; });
  const unit = (v) => v.map((value) => value / Math.hypot(...v));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const places = {
    // All of the city is in view; one turn in 30 s.
    around: (t) => ({ position: [30 * Math.sin(t / 4.8), -18, -30 * Math.cos(t / 4.8)], target: [0, 0, 0] }),
    // Down a street, looking left and right.
    street: (t) => ({ position: [0, -0.8, -16 + t], target: [Math.sin(t / 2), -0.8, -14 + t] }),
  };
  globalThis.cameraAt = (path, t) => {
    const { position, target } = places[path](t);
    const forward = unit(target.map((value, i) => value - position[i]));
    const right = unit(cross([0, 1, 0], forward));
    const rows = [right, cross(forward, right), forward];
    const w2c = rows.flatMap((row) => [...row, -row.reduce((sum, value, i) => sum + value * position[i], 0)]);
    const focal = Math.min(width, height) / 2 / Math.tan(fov / 2);
    return { width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, w2c };
  };
  const look = (path, t) => {
    if (engine === "ours") viewer().camera = { ...places[path](t), fov };
    else globalThis.look(globalThis.cameraAt(path, t));
  };
  /** Milliseconds of each frame, drawn to its end; the camera goes on by as much at each. */
  globalThis.fly = (path, count) => new Promise((done) => {
    const canvas = (engine === "ours" ? viewer().shadowRoot : document).querySelector("canvas");
    const gl = canvas.getContext("webgl2");
    const pixel = new Uint8Array(4);
    const frames = [];
    let number = 0, last = 0;
    const step = () => {
      const bound = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
      const now = performance.now();
      // The first two are for what a new view needs.
      if (number > 2) frames.push(now - last);
      last = now;
      if (++number > count + 2) {
        done({ frames, triangles: Math.round(triangles), camera: cameraAt(path, (number - 1) / 8) });
        return;
      }
      triangles = 0;
      look(path, number / 8);
      requestAnimationFrame(step);
    };
    look(path, 0);
    requestAnimationFrame(step);
  });
}
