/** One level's looks on the GPU: attributes, draw order and, while they change, the looks before. */

import type { TrainingFocals } from "../format/notes/training-focals";
import { WORDS as SLOT_WORDS } from "../decode/pack-attributes";
import { BAKE, COVER, LOOK_NAMES, ROW } from "./shaders";
import { ORDER, Program, TIMES, WORDS, makeTable, upload } from "./textures";
import type { Table } from "./textures";

/** Splats in one row of a table of attributes: a page of the decoder. */
const ROW_SPLATS = ROW / 2;
/** Units: 0 holds the centres, 1 … 4 are a layer's. */
const UNITS = { words: 1, order: 2, before: 3, times: 4 };
/** Rows that are baked at once: a texture of all would be as large as the attributes. */
const STRIP = 128;
/** Long ago: what began then has ended. */
const PAST = -1e6;

type LookProgram = Program<(typeof LOOK_NAMES)[number]>;
type Baker = Program<(typeof LOOK_NAMES)[number] | "row">;

/** Textures that exist during a change alone. */
interface Change {
  readonly before: Table;
  readonly baked: Table;
  readonly times: Table;
  readonly target: WebGLFramebuffer;
}

/** Makes the looks of a moment into attributes; one for all layers. */
export function makeBaker(gl: WebGL2RenderingContext): Baker {
  return new Program(gl, COVER, BAKE, [...LOOK_NAMES, "row"]);
}

export class Layer {
  /** Splats in the draw order. */
  count = 0;
  /** Splats from this one on are not of the level. */
  limit = 0;
  /** Focal lengths of the level's training photos; null: any camera is taken for one of theirs. */
  focals: TrainingFocals | null = null;
  readonly words: Table;
  /** The order that is drawn, and the one that the next is written to. */
  private orders: [Table, Table];
  private readonly rows: number;
  private change: Change | null = null;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly baker: Baker,
    private readonly capacity: number,
  ) {
    this.rows = Math.max(1, Math.ceil(capacity / ROW_SPLATS));
    this.words = makeTable(gl, WORDS, this.rows);
    this.orders = [makeTable(gl, ORDER, capacity / ROW), makeTable(gl, ORDER, capacity / ROW)];
  }

  setAttributes(first: number, words: Uint32Array): void {
    const count = Math.min(words.length / SLOT_WORDS, this.capacity - first);
    if (count > 0) upload(this.gl, this.words, 2 * first, 2 * count, words);
  }

  setOrder(order: Uint32Array, from: number, to: number, count: number): void {
    const [before, next] = this.orders;
    upload(this.gl, next, from, Math.min(to, this.capacity) - from, order.subarray(from));
    if (to < count) return;
    this.count = Math.min(count, this.capacity);
    this.orders = [next, before];
  }

  /** True while textures of a change are held. */
  get changing(): boolean {
    return this.change !== null;
  }

  /**
   * Keep the looks that splats first … first + count have at `time`, so that they turn into what is
   * set next over `fade` seconds. To be called before that is set; whole pages only.
   */
  keep(first: number, count: number, time: number, fade: number): void {
    const { gl } = this;
    this.change ??= this.begin();
    const { before, baked, times, target } = this.change;
    const from = Math.floor(first / ROW_SPLATS);
    const rows = Math.min(Math.ceil(count / ROW_SPLATS), this.rows - from);
    if (rows <= 0) return;
    this.baker.use();
    this.bind(this.baker, time, fade, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, baked.texture, 0);
    gl.disable(gl.BLEND);
    // A unit that the baker does not read.
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, before.texture);
    for (let row = from; row < from + rows; row += STRIP) {
      const height = Math.min(STRIP, from + rows - row);
      gl.viewport(0, 0, ROW, height);
      gl.uniform1i(this.baker.at("row"), row);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.copyTexSubImage2D(gl.TEXTURE_2D, 0, 0, row, 0, 0, ROW, height);
    }
    gl.enable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindTexture(gl.TEXTURE_2D, times.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, from, 1, rows, times.format, times.type, new Float32Array(rows).fill(time));
  }

  /** Give the memory of a change back. */
  settle(): void {
    const { gl, change } = this;
    if (!change) return;
    this.change = null;
    gl.deleteFramebuffer(change.target);
    for (const { texture } of [change.before, change.baked, change.times]) gl.deleteTexture(texture);
  }

  /** Bytes of textures. */
  get bytes(): number {
    const rows = this.change ? 2 * this.rows + Math.min(STRIP, this.rows) : this.rows;
    return 16 * ROW * rows + 8 * ROW * Math.max(1, Math.ceil(this.capacity / ROW));
  }

  /** Give a program the looks of a moment; `other` stands in where textures are not there. */
  bind(program: LookProgram, time: number, fade: number, other: Table | null): void {
    const { gl, change } = this;
    program.bind("words", UNITS.words, this.words);
    program.bind("before", UNITS.before, change?.before ?? this.words);
    program.bind("times", UNITS.times, change?.times ?? other ?? this.words);
    gl.uniform1i(program.at("limit"), this.limit);
    gl.uniform1i(program.at("changing"), Number(this.change !== null));
    gl.uniform1f(program.at("time"), time);
    gl.uniform1f(program.at("fade"), fade);
  }

  bindOrder(program: Program<"order">): void {
    program.bind("order", UNITS.order, this.orders[0]);
  }

  close(): void {
    this.settle();
    for (const { texture } of [this.words, ...this.orders]) this.gl.deleteTexture(texture);
  }

  private begin(): Change {
    const { gl, rows } = this;
    const times = makeTable(gl, TIMES, rows, 1);
    const past = new Float32Array(rows).fill(PAST);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 1, rows, times.format, times.type, past);
    const target = gl.createFramebuffer();
    return { before: makeTable(gl, WORDS, rows), baked: makeTable(gl, WORDS, Math.min(STRIP, rows)), times, target };
  }
}
