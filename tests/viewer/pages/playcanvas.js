// A PlayCanvas scene for test_engines.py: splats, and a box where it is asked for.
import * as pc from "playcanvas";
import { GsynHandler } from "./gsynopsis-playcanvas.js";
import { projectionOf, viewOf } from "./pinhole.js";

const canvas = document.querySelector("canvas");
const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false, preserveDrawingBuffer: true } });
app.autoRender = false;
app.setCanvasResolution(pc.RESOLUTION_FIXED, 240, 160);
app.loader.addHandler("gsyn", new GsynHandler(app));
app.start();
const eye = new pc.Entity("eye");
eye.addComponent("camera", {});
app.root.addChild(eye);
const material = new pc.StandardMaterial();
material.useLighting = material.useFog = material.useTonemap = false;
material.diffuse.set(0, 0, 0);
const box = new pc.Entity("box");
box.addComponent("render", { type: "box", material });
box.enabled = false;
app.root.addChild(box);
let asset = null;

const NAMES = {
  header: ["facts"], "base-ready": ["bytes", "seconds"], "level-ready": ["level", "bytes", "seconds"],
  complete: ["bytes", "seconds"], "viewer-error": ["trouble", "message"],
};
const note = (name, detail) => seen.push({ ...detail, name: name.replace("viewer-", ""), at: performance.now() });

/** The camera of the pictures from now on. */
function aim(pinhole) {
  app.setCanvasResolution(pc.RESOLUTION_FIXED, pinhole.width, pinhole.height);
  const pose = new pc.Mat4().set(viewOf(pinhole)).invert();
  eye.setPosition(pose.getTranslation());
  eye.setRotation(new pc.Quat().setFromMat4(pose));
  eye.camera.calculateProjection = (matrix) => { matrix.data.set(projectionOf(pinhole, 0.01, 1000)); };
}

/** Load a file, or nothing. */
globalThis.load = (url, options, pinhole) => {
  if (asset) {
    asset.unload();
    app.assets.remove(asset);
  }
  asset = url && new pc.Asset("scene", "gsyn", { url }, options);
  if (!asset) return;
  asset.on("error", (message) => note("viewer-error", { message }));
  asset.ready(({ resource }) => {
    note("header", {});
    for (const [name, words] of Object.entries(NAMES)) {
      resource.on(name, (...values) => note(name, Object.fromEntries(words.map((word, i) => [word, values[i]]))));
    }
    app.root.addChild(resource.entity);
  });
  app.assets.add(asset);
  app.assets.load(asset);
  aim(pinhole);
};

/** Draw a pinhole camera's picture; `what`: {level, box: {center, size, color}, background, place}. */
globalThis.draw = async (pinhole, { level = 99, box: cube = null, background = 0, place = null }) => {
  const { width, height } = pinhole;
  aim(pinhole);
  const rgb = (value) => new pc.Color([16, 8, 0].map((shift) => ((value >> shift) & 255) / 255));
  eye.camera.clearColor = rgb(background);
  box.enabled = cube !== null;
  if (cube) {
    box.setPosition(...cube.center);
    box.setEulerAngles(0, (cube.angle * 180) / Math.PI, 0);
    box.setLocalScale(cube.size, cube.size, cube.size);
    material.emissive = rgb(cube.color);
    material.update();
  }
  const splats = asset?.resource ?? null;
  if (place && splats) {
    splats.entity.setPosition(...place.position);
    splats.entity.setEulerAngles(...place.rotation.map((angle) => (angle * 180) / Math.PI));
    splats.entity.setLocalScale(place.scale, place.scale, place.scale);
  }
  splats?.setLevel(level);
  app.render();
  await splats?.settled();
  app.render();
  const { gl } = app.graphicsDevice;
  const pixels = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return { width, height, pixels, count: splats?.count ?? 0, error: gl.getError() };
};

globalThis.memory = () => ({ textures: app.graphicsDevice.textures?.length ?? 0 });
