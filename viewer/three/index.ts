/** A progressive Gaussian splatting scene (`.gsyn`) as an object of a three.js scene. */

import {
  Box3, BufferAttribute, DataTexture, DoubleSide, FloatType, GLSL3, InstancedBufferGeometry, Matrix4, Mesh, NormalBlending, Object3D,
  RGBAFormat, RGBAIntegerFormat, RawShaderMaterial, RedIntegerFormat, Sphere, UnsignedIntType, Vector3, Vector4,
} from "three";
import type { Camera, Object3DEventMap, PixelFormat, WebGLRenderer } from "three";

import type { Pinhole } from "../src/camera/camera";
import { MESH_FRAGMENT, MESH_VERTEX, instancesOf, pinholeOf, poseUniforms, quadIndex } from "../src/engines/mesh";
import type { Trouble, ViewerError } from "../src/base/errors";
import { lowPassFilter } from "../src/render/low-pass-filter";
import type { SceneFacts } from "../src/decode/messages";
import { ROW } from "../src/render/shaders";
import { Splats } from "../src/engines/scene";
import type { SplatsOptions } from "../src/engines/scene";
import type { SplatTables } from "../src/engines/splat-tables";

export type { SceneFacts, SplatsOptions, Trouble };

/** Values of a row of a table with four channels. */
const ROW_VALUES = 4 * ROW;

/** Events of a `GsynopsisSplats`, beside those of any `Object3D`. */
export interface GsynopsisSplatsEventMap extends Object3DEventMap {
  /** The file is known. */
  header: { readonly facts: SceneFacts };
  /** The coarsest level is in the next picture. */
  "base-ready": { readonly bytes: number; readonly seconds: number };
  "level-ready": { readonly level: number; readonly bytes: number; readonly seconds: number };
  /** All levels that are shown are decoded. */
  complete: { readonly bytes: number; readonly seconds: number };
  /** Bytes so far and of all; bits per second. */
  progress: { readonly bytes: number; readonly total: number; readonly rate: number };
  /** Trouble that may pass, in a sentence; empty when it has. */
  notice: { readonly text: string };
  "viewer-error": { readonly trouble: Trouble; readonly message: string };
  /** The next image will be another one: for pages that draw on demand. */
  change: object;
}

/**
 * Splats of a `.gsyn` file that refine while it comes, blended over what is behind them and hidden by what is
 * before them. They stand in the file's own coordinates, mostly y down: turn the object as you like.
 */
export class GsynopsisSplats extends Object3D<GsynopsisSplatsEventMap> {
  readonly isGsynopsisSplats = true;
  /** The camera that decoding and order follow where a scene is drawn by several; null: each that draws. */
  camera: Camera | null = null;
  private readonly splats: Splats;
  private readonly mesh: Mesh<InstancedBufferGeometry, RawShaderMaterial>;
  private textures: Record<"centers" | "words" | "order", DataTexture> | null = null;
  private readonly viewport = new Vector4();
  private readonly view = new Matrix4();

  /** `source`: the file's address, or the file. */
  constructor(source: string | Blob, options: SplatsOptions = {}) {
    super();
    this.mesh = makeMesh();
    this.mesh.onBeforeRender = (renderer, _scene, camera) => { this.prepare(renderer, camera); };
    this.add(this.mesh);
    this.splats = new Splats(source, options, {
      header: (facts) => { this.begin(facts); },
      base: (bytes, seconds) => { this.dispatchEvent({ type: "base-ready", bytes, seconds }); },
      level: (level, bytes, seconds) => { this.dispatchEvent({ type: "level-ready", level, bytes, seconds }); },
      complete: (bytes, seconds) => { this.dispatchEvent({ type: "complete", bytes, seconds }); },
      progress: ({ bytes, total, rate }) => { this.dispatchEvent({ type: "progress", bytes, total, rate }); },
      notice: (text) => { this.dispatchEvent({ type: "notice", text }); },
      error: ({ trouble, message }: ViewerError) => { this.dispatchEvent({ type: "viewer-error", trouble, message }); },
      changed: () => { this.dispatchEvent({ type: "change" }); },
    });
  }

  /** Header and manifest of the file; null before `header`. */
  get facts(): SceneFacts | null {
    return this.splats.facts;
  }

  /** Splats in the last draw order. */
  get count(): number {
    return this.splats.tables?.count ?? 0;
  }

  /** Show no finer than a level. */
  setLevel(level: number): void {
    this.splats.setLevel(level);
  }

  /** Resolves when all that has come is decoded and sorted for the camera of the last picture: the next is exact. */
  settled(): Promise<void> {
    return this.splats.settled();
  }

  /** End the workers and give memory back. */
  dispose(): void {
    this.splats.close();
    this.remove(this.mesh);
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    for (const texture of Object.values(this.textures ?? {})) texture.dispose();
    this.textures = null;
  }

  private begin(facts: SceneFacts): void {
    const tables = this.splats.tables!;
    const { centers, words, order, rows } = tables;
    this.textures = {
      centers: makeTexture(centers, rows, RGBAFormat),
      words: makeTexture(words, 2 * rows, RGBAIntegerFormat),
      order: makeTexture(order, rows, RedIntegerFormat),
    };
    const { geometry, material } = this.mesh;
    for (const [name, texture] of Object.entries(this.textures)) material.uniforms[name].value = texture;
    const sphere = new Sphere(new Vector3(...facts.center), facts.radius);
    geometry.boundingSphere = sphere;
    geometry.boundingBox = sphere.getBoundingBox(new Box3());
    this.mesh.visible = true;
    this.dispatchEvent({ type: "header", facts });
  }

  /** Before a picture: the camera to decoder, sorter and shader, and what has come to the textures. */
  private prepare(renderer: WebGLRenderer, camera: Camera): void {
    const { tables } = this.splats;
    if (!tables || !this.textures) return;
    const { z: width, w: height } = renderer.getCurrentViewport(this.viewport);
    this.view.multiplyMatrices(camera.matrixWorldInverse, this.mesh.matrixWorld);
    const pinhole = pinholeOf(this.view.elements, camera.projectionMatrix.elements, width, height);
    if (!this.camera || this.camera === camera) this.splats.look(pinhole);
    upload(tables, this.textures);
    const { geometry, material } = this.mesh;
    geometry.instanceCount = instancesOf(tables.count);
    setUniforms(material, tables, pinhole, camera);
    // As three.js itself does: sRGB for the screen, linear light for what is drawn elsewhere.
    material.uniforms.linear.value = renderer.getRenderTarget() !== null;
    material.uniformsNeedUpdate = true;
  }
}

function makeMesh(): Mesh<InstancedBufferGeometry, RawShaderMaterial> {
  const geometry = new InstancedBufferGeometry();
  geometry.setIndex(new BufferAttribute(quadIndex(), 1));
  geometry.instanceCount = 0;
  const names = ["centers", "words", "order", "count", "limit", "turn", "shift", "focal", "middle", "size", "dilations", "projection", "linear"];
  const material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: MESH_VERTEX,
    fragmentShader: `${MESH_FRAGMENT}\nout vec4 result;\nvoid main() { result = splat(); }`,
    uniforms: Object.fromEntries(names.map((name) => [name, { value: null }])),
    transparent: true,
    premultipliedAlpha: true,
    blending: NormalBlending,
    depthWrite: false,
    side: DoubleSide,
  });
  const mesh = new Mesh(geometry, material);
  mesh.visible = mesh.frustumCulled = false;
  mesh.raycast = () => undefined;
  return mesh;
}

function makeTexture(data: Float32Array<ArrayBuffer> | Uint32Array<ArrayBuffer>, rows: number, format: PixelFormat): DataTexture {
  const texture = new DataTexture(data, ROW, rows, format, data instanceof Float32Array ? FloatType : UnsignedIntType);
  texture.needsUpdate = true;
  return texture;
}

/** Rows that changed; where most did, or nothing was there, all. */
function upload(tables: SplatTables, textures: Record<"centers" | "words" | "order", DataTexture>): void {
  const changes = tables.takeChanges();
  for (const name of ["centers", "words"] as const) {
    const rows = changes[name];
    if (!rows.length) continue;
    for (const row of rows) textures[name].addUpdateRange(row * ROW_VALUES, ROW_VALUES);
    textures[name].needsUpdate = true;
  }
  if (changes.order) textures.order.needsUpdate = true;
}

function setUniforms(material: RawShaderMaterial, tables: SplatTables, pinhole: Pinhole, camera: Camera): void {
  const { width, height, fx, fy, cx, cy } = pinhole;
  const { uniforms } = material;
  const values = {
    ...poseUniforms(pinhole),
    count: tables.count,
    limit: tables.limit,
    focal: [fx, fy],
    middle: [cx, cy],
    size: [width, height],
    dilations: lowPassFilter(tables.focals, fx, fy),
    projection: camera.projectionMatrix,
  };
  for (const [name, value] of Object.entries(values)) uniforms[name].value = value;
}
