/** Tables on the GPU: textures whose rows hold `ROW` texels, changed in ranges; and programs. */

import { ViewerError } from "../base/errors";
import { ROW } from "./shaders";

/** One table: its texture, and how its data are given. */
export interface Table {
  readonly texture: WebGLTexture;
  readonly format: number;
  readonly type: number;
  /** Values per texel. */
  readonly channels: number;
}

/** Format of a table, the constants' names in WebGL 2. */
export type Shape = readonly ["RGB32F" | "RGBA32UI" | "R32UI" | "R32F", "RGB" | "RGBA_INTEGER" | "RED_INTEGER" | "RED", "FLOAT" | "UNSIGNED_INT", number];

export const CENTERS: Shape = ["RGB32F", "RGB", "FLOAT", 3];
export const WORDS: Shape = ["RGBA32UI", "RGBA_INTEGER", "UNSIGNED_INT", 4];
export const ORDER: Shape = ["R32UI", "RED_INTEGER", "UNSIGNED_INT", 1];
export const TIMES: Shape = ["R32F", "RED", "FLOAT", 1];

/** An empty table of so many rows. */
export function makeTable(gl: WebGL2RenderingContext, shape: Shape, rows: number, width = ROW): Table {
  const [internal, format, type, channels] = shape;
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl[internal], width, Math.max(1, Math.ceil(rows)));
  return { texture, format: gl[format], type: gl[type], channels };
}

/** Texels first … first + count of a table of full rows. */
export function upload(gl: WebGL2RenderingContext, table: Table, first: number, count: number, data: Float32Array | Uint32Array): void {
  const { channels, format, type } = table;
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
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x, Math.floor(at / ROW), width, Math.max(rows, 1), format, type, part);
    at += size;
  }
}

/** A program and the places of its uniforms; the device links it while it is not used yet. */
export class Program<Name extends string> {
  private readonly program: WebGLProgram;
  private readonly names: readonly string[];
  private places: Map<string, WebGLUniformLocation | null> | null = null;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    vertex: string,
    fragment: string,
    names: readonly Name[],
  ) {
    this.names = names;
    this.program = link(gl, vertex, fragment);
  }

  /** To be called before `at` and `bind`. Throws where the device cannot link it. */
  use(): void {
    const { gl, program } = this;
    if (!this.places) {
      check(gl, program);
      this.places = new Map(this.names.map((name) => [name, gl.getUniformLocation(program, name)]));
    }
    gl.useProgram(program);
  }

  close(): void {
    this.gl.deleteProgram(this.program);
  }

  at(name: Name): WebGLUniformLocation | null {
    return this.places?.get(name) ?? null;
  }

  /** Read a sampler from a texture unit that holds a table. */
  bind(name: Name, unit: number, table: Table): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, table.texture);
    gl.uniform1i(this.at(name), unit);
  }
}

function link(gl: WebGL2RenderingContext, vertex: string, fragment: string): WebGLProgram {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]] as const) {
    const shader = gl.createShader(kind);
    if (!shader) throw new ViewerError("DeviceError", "The graphics device was lost.");
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}

/** Waits until a program is linked. */
function check(gl: WebGL2RenderingContext, program: WebGLProgram): void {
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const log = gl.getProgramInfoLog(program) ?? "";
    throw new ViewerError("DeviceError", `This graphics device cannot draw the scene: ${log}`);
  }
}
