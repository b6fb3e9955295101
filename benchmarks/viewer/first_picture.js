// Runs before the viewer's page: `facts()` says when its script ran and when its first picture was.
// A page that sends the browser on to another address begins with the first one.
sessionStorage.began ??= performance.timeOrigin;
const found = { defined: 0, first: 0, firstLit: 0, lit: 0 };
/** Share of the pixels that a picture of the scene lights at least. */
const LEAST = 0.02;

globalThis.facts = () => ({ ...found, heard, origin: performance.timeOrigin, began: Number(sessionStorage.began) });
customElements.whenDefined("gsynopsis-viewer").then(() => { found.defined = performance.now(); });
let based = false;
addEventListener("base-ready", () => { based = true; measureBase(); }, true);

/** Reading pixels back takes the device long: not before the first picture is there. */
function measureBase() {
  if (based && found.first) found.lit = lit();
}

function lit() {
  const { pixels } = globalThis.viewer().scene.capture(true);
  let count = 0;
  for (let i = 0; i < pixels.length; i += 4) count += Math.max(...pixels.subarray(i, i + 3)) > 8;
  return (4 * count) / pixels.length;
}

let drawn = 0;
/** After the callbacks of each frame: once the device has done what the frame drew, are there pixels? */
function look() {
  const scene = globalThis.viewer()?.scene;
  const before = drawn;
  drawn = scene?.drawn ?? 0;
  if (drawn <= before) return void next();
  const gl = scene.canvas.getContext("webgl2");
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  const poll = () => {
    if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return void setTimeout(poll, 2);
    const now = performance.now();
    const share = lit();
    if (share < LEAST) return void next();
    Object.assign(found, { first: now, firstLit: share });
    measureBase();
  };
  poll();
}
function next() {
  requestAnimationFrame(() => setTimeout(look));
}
next();
