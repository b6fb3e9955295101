/** Workers from the script beside this module, also on another host, or from the one inside a page that is one file. */

/** The element that holds the workers' script in a page that is one file. */
const INLINE = "gsynopsis-worker";
/** The workers' script as seen from this module; the build puts a string in its place. */
declare const WORKER_SCRIPT: string;

export function inWorker(): boolean {
  return typeof document === "undefined" && "WorkerGlobalScope" in globalThis;
}

export function spawnWorker(): Worker {
  // The page that comes with this module has started some (public/index.html).
  const started = (globalThis as { gsynopsisWorkers?: Worker[] }).gsynopsisWorkers?.pop();
  if (started) return started;
  // Pages of the disk may not start module workers: theirs is a plain script.
  const inline = document.getElementById(INLINE)?.textContent ?? "";
  if (inline.trim()) return new Worker(addressOf(inline));
  // Bundlers know this form and keep the file whole beside what they make of the page's modules.
  const script = `import ${JSON.stringify(new URL(/* @vite-ignore */ WORKER_SCRIPT, import.meta.url).href)};`;
  return new Worker(addressOf(script), { type: "module" });
}

function addressOf(script: string): string {
  return URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
}
