// Runs before a viewer's own scripts. `shown` is when a canvas first showed the scene, ms since the epoch, 0 before;
// from then on the picture is kept four times a second. `still()`: it has not changed for two seconds.
// `quality()`: of each kept picture the time, ms since the epoch, and the mean squared error to the last one, of 1.
globalThis.shown = 0;
/** Share of the pixels that a picture of the scene lights at least, and the brightness of a lit one. */
const LEAST = 0.02, BRIGHT = 8;
/** Pictures that are alike at the end, and the mean squared error of two such, of 1. */
const ALIKE = 8, SAME = 1e-6;
const canvases = new Set();
const kept = [];
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  if (!kind.startsWith("webgl")) return context.call(this, kind, options);
  canvases.add(this);
  return context.call(this, kind, { ...options, preserveDrawingBuffer: true });
};
const small = new OffscreenCanvas(64, 48).getContext("2d", { willReadFrequently: true });
let full;

/** The pixels of the largest canvas that lights enough of them, RGBA. */
function picture(pen) {
  const { width, height } = pen.canvas;
  for (const canvas of [...canvases].sort((a, b) => b.width * b.height - a.width * a.height)) {
    pen.fillRect(0, 0, width, height);
    pen.drawImage(canvas, 0, 0, width, height);
    const { data } = pen.getImageData(0, 0, width, height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) count += Math.max(data[i], data[i + 1], data[i + 2]) > BRIGHT;
    if (4 * count >= LEAST * data.length) return data;
  }
  return null;
}

function error(a, b) {
  let sum = 0;
  for (let i = 0; i < a.length; i += 4) for (let c = i; c < i + 3; c++) sum += (a[c] - b[c]) ** 2;
  return sum / (a.length * 0.75 * 255 * 255);
}

globalThis.still = () => kept.length > ALIKE && kept.slice(-ALIKE).every(({ data }) => error(data, kept.at(-1).data) < SAME);
globalThis.quality = () => kept.map(({ at, data }) => [at, error(data, kept.at(-1).data)]);

const timer = setInterval(() => {
  if (!picture(small)) return;
  globalThis.shown = Date.now();
  clearInterval(timer);
  full = new OffscreenCanvas(innerWidth, innerHeight).getContext("2d", { willReadFrequently: true });
  keep();
  setInterval(keep, 250);
}, 50);

function keep() {
  const at = Date.now();
  const data = picture(full);
  if (data) kept.push({ at, data });
}
