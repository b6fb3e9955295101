/** The kernels of wasm/kernel.c. */

import { ALPHA_MIN, BATCH, SLOT_VALUES } from "./kernel";
import type { Batch, Kernel, Slots } from "./kernel";
import { KERNEL } from "./wasm.gen";
import type { Layer, PackedNetworks } from "../packed-networks";
import { LazyModule } from "../../base/lazy-module";
import type * as js from "./js";

/** The kernel without WebAssembly, which few devices need. */
export const jsKernelModule = new LazyModule<typeof js>();

const PAGE = 65536;

interface Exports {
  readonly __heap_base: WebAssembly.Global;
  gather(u: number, n: number, table: number, rows: number, resolution: number, features: number, out: number, stride: number): void;
  look_up(codes: number, n: number, book: number, width: number, out: number, stride: number): void;
  dense(x: number, n: number, ins: number, stride: number, weights: number, start: number, rows: number, outs: number, relu: number, out: number): void;
  heads(hidden: number, width: number, owners: number, slots: number, count: number, nets: number, least: number, out: number): void;
}

type Storable = Float32Array | Uint32Array | Uint8Array;

/** Memory is handed out once and never freed: weights and grids by array, buffers by name. */
export class SimdKernel implements Kernel {
  readonly name = "wasm";
  private readonly memory: WebAssembly.Memory;
  private readonly call: Exports;
  private readonly placed = new WeakMap<Storable, number>();
  private readonly nets = new WeakMap<PackedNetworks, number>();
  private readonly buffers = new Map<string, { at: number; size: number }>();
  private end: number;

  /** Throws where WebAssembly or its SIMD is not there. */
  static async create(): Promise<SimdKernel> {
    const bytes = Uint8Array.from({ length: KERNEL.length / 2 }, (_, i) => parseInt(KERNEL.slice(2 * i, 2 * i + 2), 16));
    const memory = new WebAssembly.Memory({ initial: 2 });
    const { instance } = await WebAssembly.instantiate(bytes, { env: { memory } });
    return new SimdKernel(memory, instance.exports as unknown as Exports);
  }

  private constructor(memory: WebAssembly.Memory, exports: Exports) {
    this.memory = memory;
    this.call = exports;
    this.end = Number(exports.__heap_base.value);
  }

  features(part: PackedNetworks, batch: Batch, out: Float32Array): void {
    const { width, gridFeatures, codeWidth, residual } = part;
    const n = batch.count;
    const u = this.into("u", batch.u);
    const codes = this.into("codes", batch.codes);
    let x = this.buffer("x", 4 * BATCH * width);
    part.grids.forEach((grid, g) => {
      const to = x + 4 * g * gridFeatures;
      this.call.gather(u, n, this.place(grid.table), grid.rows, grid.resolution, gridFeatures, to, width);
    });
    const at = part.grids.length * gridFeatures;
    if (codeWidth) this.call.look_up(codes, n, this.place(part.codebook), codeWidth, x + 4 * at, width);
    if (residual) {
      const floats = new Float32Array(this.memory.buffer);
      for (let i = 0; i < n; i++) {
        const own = batch.residual.subarray(i * residual, (i + 1) * residual);
        floats.set(own, (x >> 2) + i * width + at + codeWidth);
      }
    }
    let stride = width;
    part.fuse.forEach((layer, k) => {
      const next = this.buffer(`fuse${k}`, 4 * BATCH * layer.outs);
      this.dense(layer, x, n, stride, k === 0, next);
      x = next;
      stride = layer.outs;
    });
    const hidden = this.buffer("hidden", 4 * BATCH * part.first.outs);
    this.dense(part.first, x, n, stride, false, hidden);
    out.set(this.floats(hidden, n * part.first.outs));
  }

  heads(part: PackedNetworks, n: number, hidden: Float32Array, view: Float32Array, slots: Slots, out: Float32Array): void {
    const outs = part.view.outs;
    const start = this.into("hidden", hidden.subarray(0, n * outs), 4 * BATCH * outs);
    const x = this.into("view", view);
    const inner = this.buffer("inner", 4 * BATCH * outs);
    const weights = this.place(part.view.weights);
    this.call.dense(x, n, 4, 4, weights, start, 1, outs, 1, inner);
    const most = BATCH * part.slots;
    const owners = this.into("owners", slots.owners.subarray(0, slots.count), 4 * most);
    const chosen = this.into("slots", slots.slots.subarray(0, slots.count), most);
    const result = this.buffer("result", 4 * SLOT_VALUES * most);
    const nets = this.netsOf(part);
    this.call.heads(inner, part.hidden, owners, chosen, slots.count, nets, ALPHA_MIN, result);
    out.set(this.floats(result, slots.count * SLOT_VALUES));
  }

  /** Bytes of memory taken. */
  get bytes(): number {
    return this.memory.buffer.byteLength;
  }

  private dense(layer: Layer, x: number, n: number, stride: number, relu: boolean, out: number): void {
    const [weights, start] = [this.place(layer.weights), this.place(layer.start)];
    this.call.dense(x, n, layer.ins, stride, weights, start, 0, layer.outs, Number(relu), out);
  }

  private netsOf(part: PackedNetworks): number {
    let at = this.nets.get(part);
    if (at === undefined) {
      at = this.place(Uint32Array.from(part.heads, (array) => this.place(array)));
      this.nets.set(part, at);
    }
    return at;
  }

  private floats(at: number, length: number): Float32Array {
    return new Float32Array(this.memory.buffer, at, length);
  }

  /** Address of an array that does not change; copied in at the first call. */
  private place(array: Storable): number {
    let at = this.placed.get(array);
    if (at === undefined) {
      at = this.take(array.byteLength);
      this.write(at, array);
      this.placed.set(array, at);
    }
    return at;
  }

  /** Copy an array into the buffer of a name. */
  private into(name: string, array: Storable, size = array.byteLength): number {
    const at = this.buffer(name, size);
    this.write(at, array);
    return at;
  }

  private write(at: number, array: Storable): void {
    const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
    new Uint8Array(this.memory.buffer).set(bytes, at);
  }

  private buffer(name: string, size: number): number {
    let found = this.buffers.get(name);
    if (!found || found.size < size) {
      found = { at: this.take(size), size };
      this.buffers.set(name, found);
    }
    return found.at;
  }

  private take(size: number): number {
    const at = (this.end + 15) & ~15;
    this.end = at + size;
    const lacking = this.end - this.memory.buffer.byteLength;
    if (lacking > 0) this.memory.grow(Math.ceil(lacking / PAGE));
    return at;
  }
}

/** The fastest kernel that runs here. */
export async function bestKernel(): Promise<Kernel> {
  try {
    return await SimdKernel.create();
  } catch {
    const { PlainKernel } = await jsKernelModule.get();
    return new PlainKernel();
  }
}
