/** One level's looks on a WebGPU device: attributes and, while they change, the looks before. */

import type { TrainingFocals } from "../../format/notes/training-focals";
import { SLOTS_PER_MESSAGE as PAGE, WORDS } from "../../decode/pack-attributes";
import type { SplatLayer } from "../side";
import { KEEP_LOOKS } from "./kernels.gen";
import { groupsOf, packParams, run } from "./kernel";
import type { Kernels } from "./kernel";

/** Long ago: what began then has ended. */
const PAST = -1e6;
/** Bytes of a splat's attributes. */
export const SLOT = 4 * WORDS;

/** Buffers that exist during a change alone. */
interface Change {
  readonly before: GPUBuffer;
  readonly times: GPUBuffer;
}

export class GpuLayer implements SplatLayer {
  /** Splats in the draw order; nothing is drawn before there is one. */
  count = 0;
  limit = 0;
  focals: TrainingFocals | null = null;
  readonly words: GPUBuffer;
  /** The same in main memory, for who asks what is where. */
  readonly copy: Uint32Array;
  private change: Change | null = null;
  /** Splats from before a change may stand below this. */
  private end = 0;

  constructor(private readonly kernels: Kernels, private readonly capacity: number) {
    this.words = kernels.buffer(SLOT * capacity);
    this.copy = new Uint32Array(WORDS * capacity);
  }

  setAttributes(first: number, words: Uint32Array): void {
    const count = Math.min(words.length / WORDS, this.capacity - first);
    if (count <= 0) return;
    const part = words.subarray(0, WORDS * count);
    this.copy.set(part, WORDS * first);
    this.kernels.device.queue.writeBuffer(this.words, SLOT * first, part as Uint32Array<ArrayBuffer>);
  }

  /** The device sorts by itself: what counts is that there is something to draw. */
  setOrder(_order: Uint32Array, _from: number, to: number, count: number): void {
    if (to === count) this.count = count;
  }

  get changing(): boolean {
    return this.change !== null;
  }

  /** Splats that may be drawn are below this. */
  get reach(): number {
    return Math.max(this.limit, this.end);
  }

  keep(first: number, count: number, time: number, fade: number): void {
    const { kernels, words } = this;
    const { device } = kernels;
    this.change ??= this.begin();
    this.end = Math.max(this.end, this.limit);
    const { before, times } = this.change;
    const some = Math.min(count, this.capacity - first);
    if (some <= 0) return;
    const params = kernels.uniform(32);
    device.queue.writeBuffer(params, 0, packParams(KEEP_LOOKS, [first, some, this.limit, 1, time, fade]));
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    run(pass, kernels.call(KEEP_LOOKS, params, words, before, times), groupsOf(some));
    pass.end();
    device.queue.submit([encoder.finish()]);
    params.destroy();
    const pages = Math.ceil(some / PAGE);
    device.queue.writeBuffer(times, 4 * Math.floor(first / PAGE), new Float32Array(pages).fill(time));
  }

  settle(): void {
    const { change } = this;
    this.change = null;
    this.end = 0;
    change?.before.destroy();
    change?.times.destroy();
  }

  /** Attributes, the looks before and the times of their change, for kernels; `other` stands in for times that are not there. */
  looks(other: GPUBuffer): [GPUBuffer, GPUBuffer, GPUBuffer] {
    const { words, change } = this;
    return [words, change?.before ?? words, change?.times ?? other];
  }

  /** Bytes on the device. */
  get bytes(): number {
    return this.words.size + (this.change ? this.change.before.size + this.change.times.size : 0);
  }

  close(): void {
    this.settle();
    this.words.destroy();
  }

  private begin(): Change {
    const { kernels, capacity } = this;
    const pages = Math.ceil(capacity / PAGE);
    const times = kernels.buffer(4 * pages);
    kernels.device.queue.writeBuffer(times, 0, new Float32Array(pages).fill(PAST));
    return { before: kernels.buffer(SLOT * capacity), times };
  }
}
