/** A progressive Gaussian splatting scene (`.gsyn`) as an asset of the PlayCanvas engine. */

import {
  ADDRESS_CLAMP_TO_EDGE, Asset, BLEND_PREMULTIPLIED, BoundingBox, CULLFACE_NONE, Entity, EventHandler, FILTER_NEAREST, GAMMA_SRGB, Mesh,
  MeshInstance, PIXELFORMAT_R32U, PIXELFORMAT_RGBA32F, PIXELFORMAT_RGBA32U, ResourceHandler, SEMANTIC_POSITION, ShaderMaterial, Texture, Vec3,
} from "playcanvas";
import type { AppBase, CameraComponent, EventHandle, GraphicsDevice, Layer } from "playcanvas";

import type { Pinhole } from "../src/camera/camera";
import { MESH_FRAGMENT, MESH_VERTEX, instancesOf, pinholeOf, poseUniforms, quadIndex } from "../src/engines/mesh";
import type { Trouble } from "../src/base/errors";
import { lowPassFilter } from "../src/render/low-pass-filter";
import type { SceneFacts } from "../src/decode/messages";
import { BATCH, ROW } from "../src/render/shaders";
import { Splats } from "../src/engines/scene";
import type { SplatsOptions } from "../src/engines/scene";
import type { SplatTables } from "../src/engines/splat-tables";

export type { SceneFacts, SplatsOptions, Trouble };

type Textures = Record<"centers" | "words" | "order", Texture>;

/**
 * Splats of a `.gsyn` file that refine while it comes, blended over what is behind them and hidden by what is
 * before them. They stand in the file's own coordinates, mostly y down: turn the entity as you like.
 *
 * Fires `header` (facts), `base-ready` and `complete` (bytes, seconds), `level-ready` (level, bytes, seconds),
 * `progress` (bytes, total, rate), `notice` (text), `viewer-error` (trouble, message) and `change`.
 */
export class GsynopsisSplats extends EventHandler {
  /** To be added to the scene, once: decoding follows the eye of who sees it. */
  readonly entity = new Entity("gsynopsis");
  /** The camera that decoding and order follow where a scene is drawn by several; null: each that draws. */
  camera: CameraComponent | null = null;
  private readonly splats: Splats;
  private readonly frames: EventHandle;
  private readonly material: ShaderMaterial;
  private instance: MeshInstance | null = null;
  private textures: Textures | null = null;

  /** `source`: the file's address, or the file. */
  constructor(
    private readonly app: AppBase,
    source: string | Blob,
    options: SplatsOptions = {},
  ) {
    super();
    this.material = makeMaterial();
    this.splats = new Splats(source, options, {
      header: (facts) => { this.begin(facts); },
      base: (bytes, seconds) => { this.fire("base-ready", bytes, seconds); },
      level: (level, bytes, seconds) => { this.fire("level-ready", level, bytes, seconds); },
      complete: (bytes, seconds) => { this.fire("complete", bytes, seconds); },
      progress: ({ bytes, total, rate }) => { this.fire("progress", bytes, total, rate); },
      notice: (text) => { this.fire("notice", text); },
      error: ({ trouble, message }) => { this.fire("viewer-error", trouble, message); },
      changed: () => {
        app.renderNextFrame = true;
        this.fire("change");
      },
    });
    this.frames = app.scene.on("prerender:layer", (...[camera, layer, transparent]: [CameraComponent, Layer, boolean]) => {
      if (transparent) this.prepare(camera, layer);
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

  /** End the workers and give memory back; `Asset.unload` calls it. */
  destroy(): void {
    this.frames.off();
    this.splats.close();
    this.entity.destroy();
    this.material.destroy();
    for (const texture of Object.values(this.textures ?? {})) texture.destroy();
    this.textures = this.instance = null;
  }

  private begin(facts: SceneFacts): void {
    const { graphicsDevice: device } = this.app;
    const { centers, words, order, rows } = this.splats.tables!;
    this.textures = {
      centers: makeTexture(device, centers, rows, PIXELFORMAT_RGBA32F),
      words: makeTexture(device, words, 2 * rows, PIXELFORMAT_RGBA32U),
      order: makeTexture(device, order, rows, PIXELFORMAT_R32U),
    };
    for (const [name, texture] of Object.entries(this.textures)) this.material.setParameter(name, texture);
    const instance = new MeshInstance(makeMesh(device), this.material);
    instance.setInstancing(true);
    instance.instancingCount = 0;
    const { radius } = facts;
    instance.setCustomAabb(new BoundingBox(new Vec3(...facts.center), new Vec3(radius, radius, radius)));
    this.instance = instance;
    this.entity.addComponent("render", { meshInstances: [instance], castShadows: false, receiveShadows: false });
    this.fire("header", facts);
  }

  /** Before a camera draws a layer: it to decoder, sorter and shader, and what has come to the textures. */
  private prepare(camera: CameraComponent, layer: Layer): void {
    const { instance, textures } = this;
    const { tables } = this.splats;
    if (!tables || !textures || !instance || !layer.meshInstances.includes(instance)) return;
    const { z, w } = camera.rect;
    const target = camera.renderTarget as { width: number; height: number } | null;
    const { width, height } = target ?? this.app.graphicsDevice;
    const view = camera.viewMatrix.clone().mul(this.entity.getWorldTransform());
    const pinhole = pinholeOf(view.data, camera.projectionMatrix.data, Math.floor(z * width), Math.floor(w * height));
    if (!this.camera || this.camera === camera) this.splats.look(pinhole);
    const changes = tables.takeChanges();
    if (changes.centers.length) textures.centers.upload();
    if (changes.words.length) textures.words.upload();
    if (changes.order) textures.order.upload();
    instance.instancingCount = instancesOf(tables.count);
    setUniforms(this.material, tables, pinhole, camera);
  }
}

/** Loads assets of the type `gsyn`; the resource, a `GsynopsisSplats`, is there with the file's header. */
export class GsynHandler extends ResourceHandler {
  constructor(app: AppBase) {
    super(app, "gsyn");
  }

  override load(url: string | { load: string; original: string }, callback: (problem: string | null, resource?: GsynopsisSplats) => void, asset?: Asset): void {
    const address = typeof url === "string" ? url : url.load;
    const splats = new GsynopsisSplats(this.app, address, asset?.data ?? {});
    let told = false;
    splats.once("header", () => {
      told = true;
      callback(null, splats);
    });
    splats.once("viewer-error", (_trouble: Trouble, message: string) => {
      if (told) return;
      splats.destroy();
      callback(message);
    });
  }

  override open(_url: string, data: unknown): unknown {
    return data;
  }
}

function makeMaterial(): ShaderMaterial {
  const material = new ShaderMaterial({
    uniqueName: "GsynopsisSplats",
    vertexGLSL: MESH_VERTEX,
    fragmentGLSL: `${MESH_FRAGMENT}\nvoid main() { gl_FragColor = splat(); }`,
    attributes: { vertex_position: SEMANTIC_POSITION },
  });
  material.blendType = BLEND_PREMULTIPLIED;
  material.depthWrite = false;
  material.cull = CULLFACE_NONE;
  material.update();
  return material;
}

/** Quads whose corners the shader places: the engine asks for positions all the same. */
function makeMesh(device: GraphicsDevice): Mesh {
  const mesh = new Mesh(device);
  mesh.setPositions(new Float32Array(12 * BATCH));
  mesh.setIndices(quadIndex());
  mesh.update();
  return mesh;
}

function makeTexture(device: GraphicsDevice, data: Float32Array | Uint32Array, rows: number, format: number): Texture {
  // The engine takes arrays of the format's kind; its types know bytes alone.
  const levels: unknown = [data];
  return new Texture(device, {
    width: ROW,
    height: rows,
    format,
    mipmaps: false,
    minFilter: FILTER_NEAREST,
    magFilter: FILTER_NEAREST,
    addressU: ADDRESS_CLAMP_TO_EDGE,
    addressV: ADDRESS_CLAMP_TO_EDGE,
    levels: levels as Uint8Array[],
  });
}

function setUniforms(material: ShaderMaterial, tables: SplatTables, pinhole: Pinhole, camera: CameraComponent): void {
  const { width, height, fx, fy, cx, cy } = pinhole;
  const { turn, shift } = poseUniforms(pinhole);
  const values = {
    turn,
    shift,
    count: tables.count,
    limit: tables.limit,
    focal: [fx, fy],
    middle: [cx, cy],
    size: [width, height],
    dilations: lowPassFilter(tables.focals, fx, fy),
    projection: [...camera.projectionMatrix.data],
    linear: Number(camera.gammaCorrection !== GAMMA_SRGB),
  };
  for (const [name, value] of Object.entries(values)) material.setParameter(name, value);
}
