// The viewer in real Chromium. node browser.mjs PACKAGE_JSON CHROMIUM: one browser for all requests, and one more for
// those whose `context` has `webgpu`; they are lines of JSON that come in; each has its own page, and its answer goes out
// as a line: {failed}, or what it found. {url, width, height, init, steps, out, apart}; each step is {script, name} run in
// the page (its result, JSON), {until: script}, {wait: event name}, {size}, {shot: name}, {press},
// {down: key}, {up: key}, {click}, {doubleClick}, {clickOn: script}, {tap}, {hover}, {wheel}, {pinch: of a trackpad}, {drag},
// {sleep} or {heap: name} (bytes in use after a collection). `init` runs before the page's own scripts, `context` are
// Playwright's options of the browser's context. With `heap` the memory of page and workers is noted meanwhile.
import { createRequire } from "node:module";
import { writeFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { watchHeap } from "./heap.mjs";

const [packages, executablePath] = process.argv.slice(2);
const { chromium } = createRequire(packages)("playwright-core");
// A canvas of WebGPU is put on the page by Vulkan alone, whose driver is SwiftShader's too.
const launch = (webgpu) => chromium.launch({
  executablePath,
  args: ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic",
    "--disable-background-networking", ...(webgpu
      ? ["--enable-unsafe-webgpu", "--use-vulkan=swiftshader", "--enable-features=Vulkan"]
      : ["--disable-gpu"])],
});

/** What a visit to a page found; `at.step` is the step it stands at. */
async function visit(page, request, said, at) {
  const results = {};
  page.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => said.push(`pageerror: ${error.message}`));
  await page.addInitScript(() => {
    globalThis.seen = [];
    for (const type of ["header", "base-ready", "level-ready", "complete", "viewer-error"]) {
      const name = type.replace("viewer-", "");
      globalThis.addEventListener(type, (event) => {
        if (event.detail) globalThis.seen.push({ ...event.detail, name, at: performance.now() });
      });
    }
    globalThis.viewer = () => document.querySelector("gsynopsis-viewer");
    globalThis.bytes = (pixels) => {
      let text = "";
      for (let i = 0; i < pixels.length; i += 8192) text += String.fromCharCode(...pixels.subarray(i, i + 8192));
      return btoa(text);
    };
    globalThis.picture = async (camera, level) => {
      const { width, height, pixels } = await viewer().render(camera, level);
      return { width, height, pixels: bytes(pixels) };
    };
  });
  if (request.init) await page.addInitScript({ content: request.init });
  const heap = request.heap ? await watchHeap(page) : null;
  await page.goto(request.url);
  for (const step of request.steps) {
    at.step = step;
    if (step.wait) {
      await page.waitForFunction(
        ([name, level]) => globalThis.seen.some((e) => e.name === name && (level === null || e.level === level)),
        [step.wait, step.level ?? null], { timeout: step.timeout ?? 60000, polling: 50 },
      );
    } else if (step.until) {
      // Not by waitForFunction, whose eval the page's policy forbids.
      const end = Date.now() + (step.timeout ?? 60000);
      while (!(await page.evaluate(step.until))) {
        if (Date.now() > end) throw new Error(`never true: ${step.until}`);
        await page.waitForTimeout(50);
      }
    } else if (step.size) {
      await page.setViewportSize({ width: step.size[0], height: step.size[1] });
    } else if (step.shot) {
      writeFileSync(`${request.out}/${step.shot}.png`, await page.screenshot());
    } else if (step.heap) {
      results[step.heap] = await heap.settled();
    } else if (step.sleep) {
      await page.waitForTimeout(step.sleep);
    } else if (step.press) {
      await page.keyboard.press(step.press, { delay: step.delay ?? 0 });
    } else if (step.down) {
      await page.keyboard.down(step.down);
    } else if (step.up) {
      await page.keyboard.up(step.up);
    } else if (step.doubleClick) {
      await page.mouse.dblclick(...step.doubleClick);
    } else if (step.tap) {
      await page.touchscreen.tap(...step.tap);
    } else if (step.click) {
      await page.mouse.click(...step.click);
    } else if (step.clickOn) {
      await (await page.evaluateHandle(step.clickOn)).asElement().click();
    } else if (step.hover) {
      await page.mouse.move(...step.hover);
    } else if (step.wheel) {
      await page.mouse.wheel(0, step.wheel);
    } else if (step.pinch) {
      await page.keyboard.down("Control");
      await page.mouse.wheel(0, step.pinch);
      await page.keyboard.up("Control");
    } else if (step.drag) {
      await page.mouse.move(...step.drag[0]);
      await page.mouse.down({ button: step.button ?? "left" });
      await page.mouse.move(...step.drag[1], { steps: 4 });
      await page.mouse.up({ button: step.button ?? "left" });
    } else {
      results[step.name] = await page.evaluate(step.script);
    }
  }
  const seen = await page.evaluate("globalThis.seen");
  return { ...results, seen, said };
}

/** Visits after which a context is made anew, lest what they left behind adds up. */
const VISITS = 20;

/**
 * A new page, and what ends its visit; `homes` are contexts of the browser by their options, each with an empty page that opens
 * those of the visits. Starting a process takes a browser longer than most visits take, so a page shares that of
 * the one that opened it unless it is `apart`; nothing else is left for the next, whose server has another port besides.
 */
async function pageFor({ browser, homes }, request) {
  const viewport = { width: request.width, height: request.height };
  const newContext = () => browser.newContext({ viewport, ...request.context });
  if (request.apart) {
    const context = await newContext();
    return { page: await context.newPage(), end: () => context.close() };
  }
  const key = JSON.stringify(request.context);
  if (!homes.has(key)) {
    const context = await newContext();
    const page = await context.newPage();
    homes.set(key, { context, page, session: await context.newCDPSession(page), visits: 0 });
  }
  const home = homes.get(key);
  const [page] = await Promise.all([home.context.waitForEvent("page"), home.page.evaluate("void open('about:blank')")]);
  await page.setViewportSize(viewport);
  const end = async (failed) => {
    if (failed || ++home.visits === VISITS) {
      homes.delete(key);
      await home.context.close();
    } else {
      await page.close();
      await home.context.clearCookies();
      await home.session.send("Network.clearBrowserCache");
    }
  };
  return { page, end };
}

async function answer(own, request) {
  const { page, end } = await pageFor(own, request);
  const said = [];
  const at = { step: null };
  let failed = true;
  try {
    const found = await visit(page, request, said, at);
    failed = false;
    return found;
  } catch (error) {
    const seen = await page.evaluate("JSON.stringify(globalThis.seen)").catch(() => "unknown");
    const where = `at the step ${JSON.stringify(at.step)?.slice(0, 300)}, after the events ${seen}`;
    return { failed: [...said, where, error.stack].join("\n") };
  } finally {
    await end(failed);
  }
}

/** Browsers with their contexts, without WebGPU and with it. */
const browsers = new Map();
for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  const { webgpu = false, ...context } = request.context;
  if (!browsers.get(webgpu)?.browser.isConnected()) {
    browsers.set(webgpu, { browser: await launch(webgpu), homes: new Map() });
  }
  process.stdout.write(`${JSON.stringify(await answer(browsers.get(webgpu), { ...request, context }))}\n`);
}
for (const { browser } of browsers.values()) await browser.close();
