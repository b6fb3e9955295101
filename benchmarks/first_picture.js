// Runs before the viewer's page: `facts()` says when its script ran and when its first picture was.
// A page that sends the browser on to another address begins with the first one.
sessionStorage.began ??= performance.timeOrigin;
const found = { defined: 0, first: 0, firstLit: 0, lit: 0 };
/** Share of the pixels that a picture of the scene lights at least. */
const LEAST = 0.02;

globalThis.facts = () => ({ ...found, heard, origin: performance.timeOrigin, began: Number(sessionStorage.began) });
customElements.whenDefined("gsynopsis-viewer").then(() => { found.defined = performance.now(); });
addEventListener("base-ready", () => { found.lit = lit(); }, true);

function lit() {
  const { pixels } = globalThis.viewer().scene.capture(true);
  let count = 0;
  for (let i = 0; i < pixels.length; i += 4) count += Math.max(...pixels.subarray(i, i + 3)) > 8;
  return (4 * count) / pixels.length;
}

let drawn = 0;
/** Looks at what each frame has drawn, once all of its callbacks are done. */
function look() {
  const now = performance.now();
  const before = drawn;
  drawn = globalThis.viewer()?.scene?.drawn ?? 0;
  const share = drawn > before ? lit() : 0;
  if (share < LEAST) next();
  else Object.assign(found, { first: now, firstLit: share });
}
function next() {
  requestAnimationFrame(() => setTimeout(look));
}
next();
