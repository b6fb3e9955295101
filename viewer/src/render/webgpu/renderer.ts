/** Splats on a canvas by WebGPU: projected, culled, sorted and drawn on the device, frame by frame. */

import { ViewerError } from "../../base/errors";
import type { Pinhole } from "../../camera/camera";
import type { Vec } from "../../base/vec3";
import { WORDS } from "../../decode/pack-attributes";
import type { Side } from "../../decode/messages";
import { lowPassFilter } from "../low-pass-filter";
import type { OtherRenderer } from "../backend";
import type { Frame } from "../splat-renderer";
import { UploadQueue } from "../upload-queue";
import type { UploadRange } from "../upload-queue";
import { DepthSort } from "./depth-sort";
import { Kernels, groupsOf, packParams, run } from "./kernel";
import { PROJECT_SPLATS } from "./kernels.gen";
import { GpuLayer, SLOT } from "./layer";
import { Pictures, clear, ofHalf, readBack } from "./picture";
import type { Columns } from "./picture";

/** Seconds over which looks change, and splats whose attributes are given in a frame; as in WebGL 2. */
const FADE = 0.4;
const UPLOAD = 1 << 17;
/** Format of pictures that are read back. */
const HALF = "rgba16float";

export class GpuRenderer implements OtherRenderer {
  readonly api = "WebGPU";
  fade = FADE;
  readonly canvas = document.createElement("canvas");
  closed = false;
  private readonly uploads = new UploadQueue(UPLOAD);
  private readonly kernels: Kernels;
  private readonly pictures: Pictures;
  private readonly context: GPUCanvasContext;
  private readonly format = navigator.gpu.getPreferredCanvasFormat();
  private readonly params: GPUBuffer;
  private layers: [GpuLayer | null, GpuLayer | null] = [null, null];
  private centers: GPUBuffer | null = null;
  /** The same in main memory. */
  private places = new Float32Array(0);
  private sorted: DepthSort | null = null;
  private capacity = 0;
  private large: GPUTexture | null = null;

  /** `base`: the canvas of the scene, beside which this one's own is put; `short`: called where memory is. */
  constructor(
    private readonly device: GPUDevice,
    base: HTMLCanvasElement,
    readonly loss: OtherRenderer["loss"],
    private readonly short: () => void,
  ) {
    this.kernels = new Kernels(device);
    this.pictures = new Pictures(this.kernels);
    this.params = this.kernels.uniform(128);
    this.context = this.canvas.getContext("webgpu")!;
    this.context.configure({ device, format: this.format, alphaMode: "premultiplied" });
    base.after(this.canvas);
  }

  /** Only of WebGL 2, which headsets need. */
  get gl(): never {
    throw new ViewerError("DeviceError", "headsets need WebGL 2, and this scene is drawn by WebGPU.");
  }

  get most(): number {
    const { maxBufferSize, maxStorageBufferBindingSize } = this.device.limits;
    return Math.floor(Math.min(maxBufferSize, maxStorageBufferBindingSize) / SLOT);
  }

  /** Room for so many splats. That memory is short is known later, when `short` is called. */
  reset(capacity: number): boolean {
    const { device, kernels } = this;
    this.clear();
    this.capacity = capacity;
    device.pushErrorScope("out-of-memory");
    this.centers = kernels.buffer(12 * capacity);
    this.places = new Float32Array(3 * capacity);
    this.sorted = new DepthSort(kernels, capacity);
    this.layers[0] = new GpuLayer(kernels, capacity);
    device.popErrorScope().then((error) => { if (error) this.short(); }, () => undefined);
    return true;
  }

  async finished(): Promise<void> {
    await this.device.queue.onSubmittedWorkDone();
  }

  close(): void {
    this.closed = true;
    this.clear();
    this.canvas.remove();
    this.device.destroy();
  }

  layer(side: Side): GpuLayer {
    return (this.layers[side] ??= new GpuLayer(this.kernels, this.capacity));
  }

  /** Orders are the device's own. */
  later(side: Side, count: number, give: UploadRange, order = false): void {
    if (order) give(0, count);
    else this.uploads.add(side, count, give);
  }

  give(now: number): void {
    this.uploads.frame(now);
  }

  get waits(): boolean {
    return this.uploads.waits;
  }

  drop(side: Side): void {
    this.uploads.drop(side);
    this.layers[side]?.close();
    this.layers[side] = null;
  }

  get bytes(): number {
    const layers = this.layers.reduce((sum, layer) => sum + (layer?.bytes ?? 0), 0);
    return layers + (this.sorted?.bytes ?? 0) + 12 * this.capacity;
  }

  setCenters(first: number, centers: Float32Array, done: () => void): void {
    this.later(0, centers.length / 3, (from, to) => {
      const count = Math.min(to, this.capacity - first) - from;
      if (this.centers && count > 0) {
        const part = centers.subarray(3 * from, 3 * (from + count));
        this.places.set(part, 3 * (first + from));
        this.device.queue.writeBuffer(this.centers, 12 * (first + from), part as Float32Array<ArrayBuffer>);
      }
      if (3 * to === centers.length) done();
    });
  }

  draw(frame: Frame): void {
    const { width, height } = frame.camera;
    this.resize(width, height);
    this.paint(frame, this.context.getCurrentTexture(), this.format);
  }

  drawFiner(frame: Frame, times: number, camera: Pinhole): void {
    const { device, format } = this;
    const { width, height } = camera;
    if (this.large?.width !== width || this.large.height !== height) {
      this.large?.destroy();
      const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING;
      this.large = device.createTexture({ size: [width, height], format, usage });
    }
    this.paint({ ...frame, camera }, this.large, format);
    this.resize(frame.camera.width, frame.camera.height);
    const encoder = device.createCommandEncoder();
    this.pictures.shrink(encoder, this.large, this.context.getCurrentTexture().createView(), format, times);
    device.queue.submit([encoder.finish()]);
  }

  async capture(frame: Frame): Promise<Uint8ClampedArray> {
    const { device } = this;
    const { width, height } = frame.camera;
    const texture = device.createTexture({ size: [width, height], format: HALF, usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC });
    this.paint(frame, texture, HALF);
    const pixels = await readBack(device, texture);
    texture.destroy();
    return pixels;
  }

  solids(up: Vec, opacityMin: number): Float32Array {
    const { copy, limit } = this.layer(0);
    const floats = new Float32Array(copy.buffer);
    const [x, y, z] = up;
    const found = new Float32Array(6 * limit);
    let to = 0;
    for (let splat = 0; splat < limit; splat++) {
      const at = WORDS * splat;
      const opacity = ofHalf(copy[at + 7] >>> 16);
      if (opacity < opacityMin) continue;
      const [xx, xy, xz, yy, yz, zz] = floats.subarray(at, at + 6);
      const high = x * x * xx + y * y * yy + z * z * zz + 2 * (x * y * xy + x * z * xz + y * z * yz);
      const wide = Math.sqrt(0.5 * (xx + yy + zz));
      found.set(this.places.subarray(3 * splat, 3 * splat + 3), to);
      // A byte holds the share where it is read back from WebGL 2.
      found[to + 3] = Math.min(wide, Math.max(Math.sqrt(Math.max(high, 0)), wide / 255));
      found[to + 4] = wide;
      found[to + 5] = opacity;
      to += 6;
    }
    return found.slice(0, to);
  }

  private resize(width: number, height: number): void {
    const { canvas } = this;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
  }

  /** Give back all that a scene needs. */
  private clear(): void {
    this.drop(0);
    this.drop(1);
    this.centers?.destroy();
    this.sorted?.close();
    this.large?.destroy();
    this.centers = this.sorted = this.large = null;
  }

  private paint(frame: Frame, texture: GPUTexture, format: GPUTextureFormat): void {
    const { width } = frame.camera;
    const [whole, left] = this.layers;
    const view = texture.createView();
    const at = left ? Math.min(width, Math.max(0, Math.round(frame.divider * width))) : 0;
    const parts: [GpuLayer | null, Columns][] = [[left, [0, at]], [whole, [at, width - at]]];
    let first = true;
    for (const [layer, columns] of parts) {
      if (!layer?.count || !columns[1]) continue;
      this.paintLayer(layer, frame, view, format, columns, first);
      first = false;
    }
    if (!first) return;
    const encoder = this.device.createCommandEncoder();
    clear(encoder, view);
    this.device.queue.submit([encoder.finish()]);
  }

  private paintLayer(layer: GpuLayer, { camera, time }: Frame, view: GPUTextureView, format: GPUTextureFormat, columns: Columns, first: boolean): void {
    const { device, kernels, centers, sorted } = this;
    if (!centers || !sorted) return;
    const { width, height, fx, fy, cx, cy } = camera;
    const [a, b, c, x, d, e, f, y, g, h, i, z] = camera.w2c;
    const dilations = lowPassFilter(layer.focals, fx, fy);
    const count = Math.min(layer.reach, this.capacity);
    device.queue.writeBuffer(this.params, 0, packParams(PROJECT_SPLATS, [
      a, b, c, d, e, f, g, h, i, x, y, z, fx, fy, cx, cy, width, height, ...dilations,
      count, layer.limit, Number(layer.changing), time, this.fade,
    ]));
    sorted.prepare(count);
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    const { drawn, seen, keys } = sorted;
    run(pass, kernels.call(PROJECT_SPLATS, this.params, centers, ...layer.looks(centers), drawn, seen, keys), groupsOf(count + 1));
    sorted.encode(pass, count);
    pass.end();
    this.pictures.draw(encoder, sorted, view, format, columns, [width, height], first);
    device.queue.submit([encoder.finish()]);
  }
}
