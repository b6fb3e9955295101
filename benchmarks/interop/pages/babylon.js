// Babylon.js: draw(job) loads a file and frame() draws, count() tells the number of its splats.
import * as fflate from "fflate";
import { Engine } from "@babylonjs/core/Engines/engine.js";
import { FreeCamera } from "@babylonjs/core/Cameras/freeCamera.js";
import { Color4, Matrix, Quaternion, Vector3 } from "@babylonjs/core/Maths/math.js";
import { Scene } from "@babylonjs/core/scene.js";
import { ImportMeshAsync } from "@babylonjs/core/Loading/sceneLoader.js";
import "@babylonjs/core/Materials/standardMaterial.js";
import "@babylonjs/loaders/SPLAT/index.js";
import "@babylonjs/loaders/glTF/2.0/index.js";
import { inverse, projection, view } from "./lens.js";

globalThis.draw = async ({ url, camera, format, spz }) => {
  const canvas = document.querySelector("canvas");
  const engine = new Engine(canvas, false);
  engine.setSize(camera.width, camera.height);
  const scene = new Scene(engine);
  scene.clearColor = new Color4(0, 0, 0, 1);
  const eye = new FreeCamera("eye", Vector3.Zero(), scene);
  eye.minZ = 0.01;
  const options = { fflate, spzLibraryUrl: spz, disableAutoCameraLimits: true };
  const { meshes } = await ImportMeshAsync(url, scene, { pluginOptions: { splat: options } });
  const mesh = meshes.find((one) => one.getClassName().startsWith("GaussianSplatting"));
  if (!mesh) throw new Error(`no splats among ${meshes.map((one) => one.getClassName())}`);
  mesh.computeWorldMatrix(true);
  // Of a GLB the root alone is Babylon's own; the node below holds the file's turn.
  const root = format === "glb" ? meshes.find((one) => one.name === "__root__") : mesh;
  const placed = inverse([...root.computeWorldMatrix(true).m]);
  const world = Matrix.FromArray(inverse(view(camera, [1, -1, 1], placed)));
  const turn = new Quaternion();
  world.decompose(undefined, turn, eye.position);
  eye.rotationQuaternion = turn;
  eye.freezeProjectionMatrix(Matrix.FromArray(projection(camera, 1)));
  globalThis.frame = () => {
    scene.render();
    return canvas.toDataURL();
  };
  globalThis.count = () => mesh.renderedSplatCount;
  return {};
};
