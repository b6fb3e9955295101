// Spark in three.js: draw(job) loads a file and gives the number of its splats; look() moves the camera; frame() draws.
import * as THREE from "three";
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import { inverse, projection, view } from "./lens.js";

globalThis.draw = async ({ url, camera, usual }) => {
  const { width, height } = camera;
  const canvas = document.querySelector("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
  renderer.setSize(width, height, false);
  renderer.setClearColor(0x000000, 1);
  const scene = new THREE.Scene();
  // As 3DGS draws: 0.3 square pixels on the diagonal, opacity as it is, order along the camera's axis.
  const exact = { preBlurAmount: 0.3, blurAmount: 0, sortRadial: false, accumExtSplats: true, maxStdDev: 3.3, minAlpha: 1 / 255 };
  scene.add(new SparkRenderer({ renderer, ...(usual ? {} : exact) }));
  const mesh = new SplatMesh({ url, extSplats: !usual });
  await mesh.initialized;
  scene.add(mesh);
  mesh.updateMatrixWorld();
  const eye = new THREE.Camera();
  eye.matrixAutoUpdate = eye.matrixWorldAutoUpdate = false;
  globalThis.look = (camera) => {
    const seen = view(camera, [1, -1, -1], inverse(mesh.matrixWorld.elements));
    eye.matrixWorld.fromArray(inverse(seen));
    eye.matrix.copy(eye.matrixWorld);
    eye.matrixWorldInverse.fromArray(seen);
    eye.matrixWorld.decompose(eye.position, eye.quaternion, eye.scale);
    eye.projectionMatrix.fromArray(projection(camera, -1));
    eye.projectionMatrixInverse.copy(eye.projectionMatrix).invert();
  };
  globalThis.look(camera);
  // Only what is timed draws by itself.
  if (usual) renderer.setAnimationLoop(() => { renderer.render(scene, eye); });
  globalThis.frame = () => {
    renderer.render(scene, eye);
    return canvas.toDataURL();
  };
  return { count: (mesh.extSplats ?? mesh.packedSplats).getNumSplats() };
};
