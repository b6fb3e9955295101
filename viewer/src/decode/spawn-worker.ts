/** Workers from the one module that this is, or from the one beside it: near the page, on another host, or inside a page. */

/** The element that holds this module in a page that is one file. */
const INLINE = "gsynopsis-viewer-module";
/** The workers' script as seen from this module; the build puts a string in its place. */
declare const WORKER_SCRIPT: string;

export function inWorker(): boolean {
  return typeof document === "undefined" && "WorkerGlobalScope" in globalThis;
}

export function makeWorker(): Worker {
  // The page that comes with this module has started some (public/index.html).
  const early = (globalThis as { gsynopsisWorkers?: Worker[] }).gsynopsisWorkers?.pop();
  if (early) return early;
  const inline = document.getElementById(INLINE)?.textContent ?? "";
  if (!inline.trim()) {
    // Bundlers know this form and keep the file whole beside what they make of the page's modules.
    const script = `import ${JSON.stringify(new URL(/* @vite-ignore */ WORKER_SCRIPT, import.meta.url).href)};`;
    return new Worker(addressOf(script), { type: "module" });
  }
  // Pages of the disk may not start module workers: make a plain script of the module.
  const plain = inline.replace(/export\s*\{[^}]*\};?\s*$/, "").replaceAll("import.meta.url", '""');
  return new Worker(addressOf(plain));
}

function addressOf(script: string): string {
  return URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
}
