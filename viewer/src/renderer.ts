/** Splats on a canvas by WebGL2: attributes in textures, many quads per instance, far to near. */

import { ViewerError } from "./errors";
import type { Attributes } from "./messages";
import { WORDS } from "./pack";
import { FRAGMENT, QUADS, ROW, VERTEX } from "./shaders";

/** A pinhole camera: OpenCV axes, pixels; as gsynopsis.scene.camera. */
export interface Pinhole {
  readonly width: number;
  readonly height: number;
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  /** World to camera, rows of [R | t]. */
  readonly w2c: readonly number[]; // [12]
}

export const NEAR = 0.01;
const UNIFORMS = ["centers", "words", "order", "count", "turn", "shift", "focal", "middle", "size", "near", "time", "fade"] as const;
type Uniform = (typeof UNIFORMS)[number];

interface Table {
  readonly texture: WebGLTexture;
  readonly format: number;
  readonly type: number;
}

export class Renderer {
  /** Seconds over which a new splat appears. */
  fade = 0.4;
  private readonly uniforms = new Map<Uniform, WebGLUniformLocation | null>();
  private tables: { centers: Table; words: Table; order: Table } | null = null;
  private capacity = 0;
  private count = 0;

  constructor(private readonly gl: WebGL2RenderingContext) {
    const program = link(gl);
    gl.useProgram(program);
    for (const name of UNIFORMS) this.uniforms.set(name, gl.getUniformLocation(program, name));
    const corners = Uint16Array.from({ length: QUADS * 6 }, (_, i) => 4 * Math.floor(i / 6) + [0, 1, 2, 2, 1, 3][i % 6]);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  }

  static create(canvas: HTMLCanvasElement | OffscreenCanvas): Renderer {
    const options = { alpha: false, antialias: false, depth: false, stencil: false, powerPreference: "high-performance" } as const;
    const gl = canvas.getContext("webgl2", options) as WebGL2RenderingContext | null;
    if (!gl) {
      throw new ViewerError("DeviceError", "This browser has no WebGL 2, which the viewer needs.");
    }
    return new Renderer(gl);
  }

  /** Splats that fit the device's textures. */
  get most(): number {
    return (this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE) as number) * (ROW / 2);
  }

  /** Room for so many splats, all of them undrawn. */
  reset(capacity: number): void {
    const { gl } = this;
    if (this.tables) for (const { texture } of Object.values(this.tables)) gl.deleteTexture(texture);
    this.capacity = capacity;
    this.count = 0;
    this.tables = {
      centers: this.table(0, gl.RGBA32F, gl.RGBA, gl.FLOAT, capacity / ROW),
      words: this.table(1, gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT, (2 * capacity) / ROW),
      order: this.table(2, gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, capacity / ROW),
    };
    if (gl.getError() === gl.OUT_OF_MEMORY) {
      throw new ViewerError("DeviceError", "This device has not enough graphics memory for the scene.");
    }
  }

  /** Centres of new splats [n, 3], which begin to appear at `birth` seconds. */
  setCenters(first: number, centers: Float32Array, birth: number): void {
    const count = Math.min(centers.length / 3, this.capacity - first);
    const rows = new Float32Array(4 * count);
    for (let i = 0; i < count; i++) {
      rows.set(centers.subarray(3 * i, 3 * i + 3), 4 * i);
      rows[4 * i + 3] = birth;
    }
    if (this.tables) this.upload(0, this.tables.centers, first, count, 4, rows);
  }

  setAttributes({ first, words }: Attributes): void {
    const count = Math.min(words.length / WORDS, this.capacity - first);
    if (this.tables && count > 0) {
      this.upload(1, this.tables.words, 2 * first, 2 * count, 4, words);
    }
  }

  setOrder(order: Uint32Array, count: number): void {
    this.count = Math.min(count, this.capacity);
    if (this.tables) this.upload(2, this.tables.order, 0, this.count, 1, order);
  }

  /** Draw at `time` seconds over a background [3] into what is bound. */
  draw(camera: Pinhole, time: number, background: readonly number[]): void {
    const { gl } = this;
    const [a, b, c, x, d, e, f, y, g, h, i, z] = camera.w2c;
    gl.viewport(0, 0, camera.width, camera.height);
    gl.clearColor(background[0], background[1], background[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!this.tables || !this.count) return;
    const at = (name: Uniform) => this.uniforms.get(name) ?? null;
    gl.uniform1i(at("centers"), 0);
    gl.uniform1i(at("words"), 1);
    gl.uniform1i(at("order"), 2);
    gl.uniform1i(at("count"), this.count);
    gl.uniformMatrix3fv(at("turn"), false, [a, d, g, b, e, h, c, f, i]);
    gl.uniform3f(at("shift"), x, y, z);
    gl.uniform2f(at("focal"), camera.fx, camera.fy);
    gl.uniform2f(at("middle"), camera.cx, camera.cy);
    gl.uniform2f(at("size"), camera.width, camera.height);
    gl.uniform1f(at("near"), NEAR);
    gl.uniform1f(at("time"), time);
    gl.uniform1f(at("fade"), this.fade);
    const instances = Math.ceil(this.count / QUADS);
    gl.drawElementsInstanced(gl.TRIANGLES, QUADS * 6, gl.UNSIGNED_SHORT, 0, instances);
  }

  /** One frame at `time` in RGB8, top row first, [height, width, 4], drawn in half precision. */
  capture(camera: Pinhole, time: number, background: readonly number[]): Uint8ClampedArray {
    const { gl } = this;
    const { width, height } = camera;
    const half = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    const target = gl.createFramebuffer();
    const buffer = gl.createRenderbuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, half ? gl.RGBA16F : gl.RGBA8, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, buffer);
    this.draw(camera, time, background);
    const pixels = half ? new Float32Array(4 * width * height) : new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, half ? gl.FLOAT : gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteRenderbuffer(buffer);
    const out = new Uint8ClampedArray(pixels.length);
    const row = 4 * width;
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < row; x++) {
        out[y * row + x] = pixels[(height - 1 - y) * row + x] * (half ? 255 : 1);
      }
    }
    for (let p = 3; p < out.length; p += 4) out[p] = 255;
    return out;
  }

  private table(unit: number, internal: number, format: number, type: number, rows: number): Table {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, internal, ROW, Math.max(1, Math.ceil(rows)));
    return { texture, format, type };
  }

  /** Texels first … first + count of a table whose rows have `ROW` of them. */
  private upload(unit: number, table: Table, first: number, count: number, channels: number, data: Float32Array | Uint32Array): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, table.texture);
    let at = first;
    const end = first + count;
    while (at < end) {
      const x = at % ROW;
      // Whole rows go as one; a part of a row at either end goes alone.
      const rows = x ? 0 : Math.floor((end - at) / ROW);
      const width = rows ? ROW : Math.min(ROW - x, end - at);
      const size = width * Math.max(rows, 1);
      const part = data.subarray((at - first) * channels, (at - first + size) * channels);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, x, Math.floor(at / ROW), width, Math.max(rows, 1), table.format, table.type, part);
      at += size;
    }
  }
}

function link(gl: WebGL2RenderingContext): WebGLProgram {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]] as const) {
    const shader = gl.createShader(kind);
    if (!shader) throw new ViewerError("DeviceError", "The graphics device was lost.");
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const log = gl.getProgramInfoLog(program) ?? "";
    throw new ViewerError("DeviceError", `This graphics device cannot draw the scene: ${log}`);
  }
  return program;
}
