// A three.js scene for test_engines.py: splats, and a box where it is asked for.
import * as THREE from "three";
import { GsynopsisSplats } from "./gsynopsis-three.js";
import { projectionOf, viewOf } from "./pinhole.js";

const canvas = document.querySelector("canvas");
const renderer = new THREE.WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
const scene = new THREE.Scene();
const camera = new THREE.Camera();
camera.matrixAutoUpdate = false;
const box = new THREE.Mesh(new THREE.BoxGeometry(), new THREE.MeshBasicMaterial());
scene.add(box);
box.visible = false;
let splats = null;

/** The camera of the pictures from now on. */
function aim(pinhole) {
  renderer.setSize(pinhole.width, pinhole.height, false);
  camera.matrix.fromArray(viewOf(pinhole)).invert();
  camera.matrixWorldNeedsUpdate = true;
  camera.projectionMatrix.fromArray(projectionOf(pinhole, 0.01, 1000));
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}

/** Load a file, or nothing. */
globalThis.load = (source, options, pinhole) => {
  splats?.dispose();
  if (splats) scene.remove(splats);
  splats = source && new GsynopsisSplats(source, options);
  if (!splats) return;
  for (const name of ["header", "base-ready", "level-ready", "complete", "viewer-error"]) {
    splats.addEventListener(name, ({ target: _, ...detail }) => seen.push({ ...detail, name: name.replace("viewer-", ""), at: performance.now() }));
  }
  splats.addEventListener("change", () => requestAnimationFrame(() => renderer.render(scene, camera)));
  scene.add(splats);
  aim(pinhole);
};

/** Draw a pinhole camera's picture; `what`: {level, box: {center, size, color}, background, place}. */
globalThis.draw = async (pinhole, { level = 99, box: cube = null, background = 0, place = null }) => {
  const { width, height } = pinhole;
  aim(pinhole);
  renderer.setClearColor(background, 1);
  box.visible = cube !== null;
  if (cube) {
    box.position.fromArray(cube.center);
    box.scale.setScalar(cube.size);
    box.rotation.y = cube.angle;
    box.material.color.set(cube.color);
  }
  if (place && splats) {
    splats.position.fromArray(place.position);
    splats.rotation.set(...place.rotation);
    splats.scale.setScalar(place.scale);
  }
  splats?.setLevel(level);
  renderer.render(scene, camera);
  await splats?.settled();
  renderer.render(scene, camera);
  const gl = renderer.getContext();
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return { width, height, pixels, count: splats?.count ?? 0, error: gl.getError() };
};

/** Linear light of the same picture, out of a target of floats. */
globalThis.drawElsewhere = (pinhole) => {
  const { width, height } = pinhole;
  const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType });
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(4 * width * height);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  renderer.setRenderTarget(null);
  return { width, height, pixels };
};

globalThis.memory = () => ({ ...renderer.info.memory });
