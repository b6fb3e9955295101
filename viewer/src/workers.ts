/** Workers from the one module that this is: beside the page, on another host, or inside a page. */

/** The element that holds this module in a page that is one file. */
const INLINE = "gsynopsis-viewer-module";

export function inWorker(): boolean {
  return typeof document === "undefined" && "WorkerGlobalScope" in globalThis;
}

export function makeWorker(): Worker {
  const inline = document.getElementById(INLINE)?.textContent ?? "";
  const script = inline.trim() || `import ${JSON.stringify(import.meta.url)};`;
  const url = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  return new Worker(url, { type: "module" });
}
