/** Splats on a canvas by WebGL2: attributes in textures, a triangle each, many per instance, far to near. */

import { ViewerError } from "../base/errors";
import { lowPassFilter } from "./low-pass-filter";
import { Layer, makeBaker } from "./layer";
import type { SplatRenderer, Frame } from "./splat-renderer";
import type { Side } from "../decode/messages";
import { BATCH, FRAGMENT, LOOK_NAMES, ROW, vertexShader } from "./shaders";
import { CENTERS, Program, makeTable, upload } from "./textures";
import type { Table } from "./textures";
import { UploadQueue } from "./upload-queue";
import type { UploadRange } from "./upload-queue";

/** Seconds over which the looks of splats change. */
const FADE = 0.4;
const NAMES = ["centers", "order", "count", "w2c", "focal", "middle", "size", "dilations", ...LOOK_NAMES] as const;

type SplatProgram = Program<(typeof NAMES)[number]>;

export class Renderer implements SplatRenderer {
  readonly canvas: HTMLCanvasElement;
  readonly loss;
  /** Seconds over which looks change; 0 where people ask for less motion. */
  fade = FADE;
  /** 4 MiB of attributes and 4 MiB of orders a frame. */
  private readonly uploads = [new UploadQueue(64 * ROW), new UploadQueue(512 * ROW)] as const;
  private readonly still: SplatProgram;
  private readonly changing: SplatProgram;
  private readonly baker;
  centers: Table | null = null;
  private readonly layers: [Layer | null, Layer | null] = [null, null];
  private capacity = 0;

  constructor(readonly gl: WebGL2RenderingContext) {
    this.still = new Program(gl, vertexShader(false), FRAGMENT, NAMES);
    this.changing = new Program(gl, vertexShader(true), FRAGMENT, NAMES);
    this.baker = makeBaker(gl);
    this.canvas = gl.canvas as HTMLCanvasElement;
    this.loss = gl.getExtension("WEBGL_lose_context");
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  }

  static create(canvas: HTMLCanvasElement | OffscreenCanvas): Renderer {
    const options = { alpha: true, antialias: false, depth: false, stencil: false, powerPreference: "high-performance" } as const;
    const gl = canvas.getContext("webgl2", options) as WebGL2RenderingContext | null;
    if (!gl) {
      throw new ViewerError("DeviceError", "This browser has no WebGL 2, which the viewer needs.");
    }
    const renderer = new Renderer(gl);
    renderer.warmUp();
    return renderer;
  }

  /** Draw a splat that nobody sees: devices make code of the shaders at their first use, now while the scene still comes. */
  private warmUp(): void {
    if (!this.reset(ROW)) return;
    this.layer(0).setOrder(new Uint32Array(1), 0, 1, 1);
    const w2c = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1];
    this.draw({ camera: { width: 1, height: 1, fx: 1, fy: 1, cx: 0, cy: 0, w2c }, time: 0, divider: 0 });
    this.close();
    this.gl.flush();
  }

  /** Splats that fit the device's textures. */
  get most(): number {
    return (this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE) as number) * (ROW / 2);
  }

  /** Room for so many splats, all of them undrawn. False where the device has not the memory. */
  reset(capacity: number): boolean {
    const { gl } = this;
    while (gl.getError() !== gl.NO_ERROR && !gl.isContextLost()) { /* of what came before */ }
    this.close();
    this.capacity = capacity;
    this.centers = makeTable(gl, CENTERS, capacity / ROW);
    this.layers[0] = new Layer(gl, this.baker, capacity);
    return gl.getError() !== gl.OUT_OF_MEMORY;
  }

  /** Resolves when the device has done all that it was given. */
  async finished(): Promise<void> {
    const { gl } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (fence && !gl.isContextLost() && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) {
      await new Promise((resolve) => setTimeout(resolve, 4));
    }
    gl.deleteSync(fence);
  }

  /** Give all memory back. */
  close(): void {
    if (this.centers) this.gl.deleteTexture(this.centers.texture);
    this.centers = null;
    this.drop(0);
    this.drop(1);
  }

  /** The layer of a side, made at its first use. */
  layer(side: Side): Layer {
    return (this.layers[side] ??= new Layer(this.gl, this.baker, this.capacity));
  }

  later(side: Side, count: number, give: UploadRange, order = false): void {
    this.uploads[Number(order)].add(side, count, give);
  }

  /** Give the device more of what has come, for a frame at `now` milliseconds. */
  give(now: number): void {
    for (const uploads of this.uploads) uploads.frame(now);
  }

  /** True while uploads wait. */
  get waits(): boolean {
    return this.uploads.some((uploads) => uploads.waits);
  }

  /** Give the memory of a side back. */
  drop(side: Side): void {
    for (const uploads of this.uploads) uploads.drop(side);
    this.layers[side]?.close();
    this.layers[side] = null;
  }

  /** Bytes of textures. */
  get bytes(): number {
    const layers = this.layers.reduce((sum, layer) => sum + (layer?.bytes ?? 0), 0);
    return layers + 12 * ROW * Math.ceil(this.capacity / ROW);
  }

  /** Centres of new splats [n, 3]; `done` is called when all are given. */
  setCenters(first: number, centers: Float32Array, done: () => void): void {
    this.later(0, centers.length / 3, (from, to) => {
      const count = Math.min(to, this.capacity - first) - from;
      if (this.centers && count > 0) upload(this.gl, this.centers, first + from, count, centers.subarray(3 * from));
      if (3 * to === centers.length) done();
    });
  }

  /** Draw into what is bound, transparent where nothing of the scene is. */
  draw(frame: Frame): void {
    const { gl } = this;
    const { camera, at: [x, y] = [0, 0] } = frame;
    gl.viewport(x, y, camera.width, camera.height);
    if (!frame.at) gl.clear(gl.COLOR_BUFFER_BIT);
    const [whole, left] = this.layers;
    if (!left) {
      if (whole) this.drawLayer(whole, frame);
      return;
    }
    const at = Math.round(frame.divider * camera.width);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, 0, at, camera.height);
    this.drawLayer(left, frame);
    gl.scissor(at, 0, camera.width - at, camera.height);
    if (whole) this.drawLayer(whole, frame);
    gl.disable(gl.SCISSOR_TEST);
  }

  private drawLayer(layer: Layer, { camera, time }: Frame): void {
    const { gl, centers } = this;
    if (!centers || !layer.count) return;
    const program = layer.changing ? this.changing : this.still;
    program.use();
    program.bind("centers", 0, centers);
    layer.bindOrder(program);
    layer.bind(program, time, this.fade, centers);
    gl.uniform1i(program.at("count"), layer.count);
    gl.uniformMatrix4x3fv(program.at("w2c"), true, camera.w2c);
    gl.uniform2f(program.at("focal"), camera.fx, camera.fy);
    gl.uniform2f(program.at("middle"), camera.cx, camera.cy);
    gl.uniform2f(program.at("size"), camera.width, camera.height);
    gl.uniform2f(program.at("dilations"), ...lowPassFilter(layer.focals, camera.fx, camera.fy));
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 3 * BATCH, Math.ceil(layer.count / BATCH));
  }

  /** One frame, top row first, [height, width, 4], colours times alpha, drawn in half precision. */
  capture(frame: Frame): Uint8ClampedArray {
    const { gl } = this;
    const { width, height } = frame.camera;
    const half = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    const target = gl.createFramebuffer();
    const buffer = gl.createRenderbuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, half ? gl.RGBA16F : gl.RGBA8, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, buffer);
    this.draw(frame);
    const pixels = half ? new Float32Array(4 * width * height) : new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, half ? gl.FLOAT : gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteRenderbuffer(buffer);
    // Halves times 255 are floats without a rest.
    const values = half ? pixels.map((value) => 255 * value) : pixels;
    const out = new Uint8ClampedArray(pixels.length);
    for (let from = 0, to = out.length; to > 0; from += 4 * width) out.set(values.subarray((to -= 4 * width), to + 4 * width), from);
    return out;
  }
}
