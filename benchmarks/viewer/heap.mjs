// Memory of a page and its workers: objects of all JavaScript heaps, what array buffers hold outside
// of them, and WebAssembly memories, which Chromium counts in neither.

const EVERY_MS = 25;
const GROUP = { objectGroup: "memories" };
const SUM = "function () { return this.reduce((total, memory) => total + memory.buffer.byteLength, 0); }";

/** Watch from now on; to be called before the page is opened. */
export async function watchHeap(page) {
  const session = await page.context().newCDPSession(page);
  const workers = new Set();
  const waiting = new Map();
  let last = 0;
  let peak = { objects: 0, buffers: 0, isolates: 0, total: 0, samples: 0 };
  let stopped = false;
  session.on("Target.attachedToTarget", ({ sessionId }) => workers.add(sessionId));
  session.on("Target.detachedFromTarget", ({ sessionId }) => workers.delete(sessionId));
  session.on("Target.receivedMessageFromTarget", ({ message }) => {
    const answer = JSON.parse(message);
    waiting.get(answer.id)?.(answer.result ?? null);
    waiting.delete(answer.id);
  });
  await session.send("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: false, flatten: false });

  async function ask(sessionId, method, params = {}) {
    if (!sessionId) return session.send(method, params);
    const id = ++last;
    const answer = new Promise((resolve) => waiting.set(id, resolve));
    await session.send("Target.sendMessageToTarget", { sessionId, message: JSON.stringify({ id, method, params }) });
    return answer;
  }

  async function sum(method) {
    const answers = await Promise.all([null, ...workers].map((id) => ask(id, method)));
    const found = answers.filter(Boolean);
    const objects = found.reduce((total, { usedSize }) => total + usedSize, 0);
    const buffers = found.reduce((total, { backingStorageSize }) => total + backingStorageSize, 0);
    return { objects, buffers, isolates: found.length, total: objects + buffers };
  }

  async function wasm(id) {
    const { result } = await ask(id, "Runtime.evaluate", { expression: "WebAssembly.Memory.prototype", ...GROUP });
    const { objects } = await ask(id, "Runtime.queryObjects", { prototypeObjectId: result.objectId, ...GROUP });
    const sum = await ask(id, "Runtime.callFunctionOn", { objectId: objects.objectId, functionDeclaration: SUM, returnByValue: true });
    await ask(id, "Runtime.releaseObjectGroup", GROUP);
    return sum.result.value;
  }

  async function watch() {
    while (!stopped) {
      const now = await sum("Runtime.getHeapUsage");
      const samples = peak.samples + 1;
      peak = now.total > peak.total ? { ...now, samples } : { ...peak, samples };
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
  }
  page.on("close", () => { stopped = true; });
  watch().catch(() => { stopped = true; });

  return {
    /** Now, after a collection, and the highest so far; memories only grow, so they are those of now. */
    async settled() {
      let memories = 0;
      for (const id of [null, ...workers]) {
        await ask(id, "HeapProfiler.collectGarbage");
        memories += await wasm(id);
      }
      const withWasm = (found) => ({ ...found, wasm: memories, total: found.total + memories });
      return { ...withWasm(await sum("Runtime.getHeapUsage")), peak: withWasm(peak) };
    },
  };
}
