// The PlayCanvas engine: draw(job) loads a file and gives the number of its splats; look() moves the camera; frame() draws.
import * as pc from "playcanvas";
import { inverse, projection, view } from "./lens.js";

const TURN = 180 / Math.PI;

globalThis.draw = async ({ url, camera, format, usual, least }) => {
  const { width, height } = camera;
  const canvas = document.querySelector("canvas");
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
  app.setCanvasFillMode(pc.FILLMODE_NONE, width, height);
  app.setCanvasResolution(pc.RESOLUTION_FIXED, width, height);
  app.autoRender = true;
  app.start();
  // Everything is drawn, at the finest level, with the most exact numbers that the engine has.
  if (!usual) Object.assign(app.scene.gsplat, {
    minPixelSize: 0, splatBudget: 0, colorUpdateAngle: 0, dataFormat: pc.GSPLATDATA_LARGE, alphaClipForward: 1 / 255,
  });
  if (least !== undefined) app.scene.gsplat.minPixelSize = least;
  const asset = new pc.Asset("splats", format === "glb" ? "container" : "gsplat", { url, filename: url.split("/").pop() });
  app.assets.add(asset);
  await new Promise((done, refuse) => {
    asset.once("load", done);
    asset.once("error", (text) => { refuse(new Error(text)); });
    app.assets.load(asset);
  });
  let entity, count;
  if (format === "glb") {
    entity = asset.resource.instantiateRenderEntity();
    app.root.addChild(entity);
    entity = entity.findComponent("gsplat").entity;
    count = entity.gsplat.resource.numSplats;
  } else {
    entity = new pc.Entity();
    entity.addComponent("gsplat", { asset });
    app.root.addChild(entity);
    count = asset.resource.numSplats ?? asset.resource.octree.nodes.reduce((sum, node) => sum + (node.lods[0]?.count ?? 0), 0);
  }
  const eye = new pc.Entity();
  eye.addComponent("camera", { clearColor: new pc.Color(0, 0, 0, 1), nearClip: 0.01, farClip: 1000, toneMapping: pc.TONEMAP_NONE });
  // The node of a GLB holds the file's own turn: the camera stands in the coordinates of its root.
  const placed = format === "glb" ? inverse(new pc.Mat4().data) : inverse(entity.getWorldTransform().data);
  globalThis.look = (camera) => {
    eye.camera.calculateProjection = (matrix) => { matrix.data.set(projection(camera, -1)); };
    const world = new pc.Mat4();
    world.data.set(inverse(view(camera, [1, -1, -1], placed)));
    eye.setPosition(world.getTranslation());
    eye.setRotation(new pc.Quat().setFromMat4(world));
  };
  globalThis.look(camera);
  app.root.addChild(eye);
  globalThis.frame = () => new Promise((done) => {
    app.once("frameend", () => { done(canvas.toDataURL()); });
  });
  return { count };
};
