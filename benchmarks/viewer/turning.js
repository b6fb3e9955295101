// Runs before the viewer's page: `turned` turns the camera around the scene by half a circle in half a second, and tells
// of each frame what was on the canvas, how many frames old its order was, and what a sorted picture looks like.
const { postMessage } = Worker.prototype;
let asked = [];
Worker.prototype.postMessage = function (message, ...more) {
  if (message.type === "sort") asked.push([...message.row]);
  return postMessage.call(this, message, ...more);
};
const copyOf = (canvas) => {
  const pen = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.drawImage(canvas, 0, 0);
  return pen.getImageData(0, 0, canvas.width, canvas.height).data;
};
const decibels = (a, b) => {
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += i % 4 < 3 ? (a[i] - b[i]) ** 2 : 0;
  return -10 * Math.log10(Math.max(1e-12, sum / (0.75 * a.length * 255 ** 2)));
};
globalThis.turned = async (seconds) => {
  const { scene } = viewer();
  await scene.settled();
  const { renderer, events } = scene;
  const layer = renderer.layer(0);
  const setOrder = layer.setOrder.bind(layer);
  let used = scene.pinhole().w2c.slice(8);
  asked = [];
  layer.setOrder = (order, from, to, count) => {
    setOrder(order, from, to, count);
    if (to === count && asked.length) used = asked.shift();
  };
  const frames = [{ row: used }];
  const begun = performance.now();
  let angle = 0;
  scene.mover = {
    active: true,
    step(camera) {
      const now = Math.min(1, (performance.now() - begun) / 1000 / seconds);
      camera.orbit(Math.PI * now - angle, 0);
      angle = Math.PI * now;
      this.active = now < 1;
    },
  };
  const { frame } = events;
  const share = (a, b) => a.every((value, i) => value === b[i]);
  await new Promise((done) => {
    events.frame = () => {
      frame();
      const camera = scene.pinhole();
      const row = camera.w2c.slice(8);
      // Nobody is told of the orders of WebGPU, which sorts on the device: its pictures tell.
      const made = frames.findLastIndex((each) => share(each.row, used));
      const late = renderer.api === "WebGPU" ? null : share(row, used) ? 0 : frames.length - made;
      frames.push({ row, camera, at: performance.now() - begun, late, pixels: copyOf(renderer.canvas) });
      if (!scene.mover.active) done();
    };
    scene.wake();
  });
  events.frame = frame;
  delete layer.setOrder;
  const found = [];
  for (const { camera, at, late, pixels } of frames.slice(1)) {
    scene.setPinhole(camera);
    await scene.settled();
    renderer.draw(scene.frameOf());
    found.push({ at, late, db: decibels(pixels, copyOf(renderer.canvas)) });
  }
  scene.setPinhole(null);
  return found;
};
