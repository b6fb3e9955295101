// Runs before a viewer's own scripts: `shown` is when a canvas first showed the scene, ms since the epoch, 0 before.
globalThis.shown = 0;
/** Share of the pixels that a picture of the scene lights at least, and the brightness of a lit one. */
const LEAST = 0.02, BRIGHT = 8;
const canvases = new Set();
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  if (!kind.startsWith("webgl")) return context.call(this, kind, options);
  canvases.add(this);
  return context.call(this, kind, { ...options, preserveDrawingBuffer: true });
};
const small = new OffscreenCanvas(64, 48);
const pen = small.getContext("2d", { willReadFrequently: true });
const timer = setInterval(() => {
  for (const canvas of canvases) {
    pen.clearRect(0, 0, 64, 48);
    pen.drawImage(canvas, 0, 0, 64, 48);
    const { data } = pen.getImageData(0, 0, 64, 48);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) count += Math.max(...data.subarray(i, i + 3)) > BRIGHT;
    if (4 * count < LEAST * data.length) continue;
    globalThis.shown = Date.now();
    clearInterval(timer);
    return;
  }
}, 50);
