/** The splats in a picture from far to near, found and sorted on the device: prefix sums and a radix sort. */

import {
  BLOCK, COMPACT_KEYS, DIGITS, LEVELS, PLAN_DRAW, PLAN_GROUPS, PLAN_SORT, PLAN_STRIDE, PLAN_WORDS, RADIX_COUNT, RADIX_SCATTER, SCAN, SCAN_ADD,
} from "./kernels.gen";
import { groupsOf, packParams, run, runPlanned } from "./kernel";
import type { Call, Kernels } from "./kernel";

/** Bytes of a `DrawnSplat`, and from one set of parameters to the next. */
const DRAWN = 32;
const STRIDE = 4 * PLAN_STRIDE;

export class DepthSort {
  /** Shape, mark (1 where it is in the picture) and key of each splat; a kernel before writes these. */
  readonly drawn: GPUBuffer;
  readonly seen: GPUBuffer;
  readonly keys: GPUBuffer;
  /** Numbers of splats, far to near. */
  readonly order: GPUBuffer;
  readonly plan: GPUBuffer;
  /** Place in `plan`, bytes, of what an indirect draw needs. */
  readonly draw = 4 * PLAN_DRAW;
  readonly bytes: number;
  private readonly params: GPUBuffer;
  private readonly made: GPUBuffer[] = [];
  private readonly marks: Sums;
  private readonly compact: Call;
  private readonly planned: Call;
  private readonly digits: { readonly count: Call; readonly scatter: Call }[] = [];
  private readonly sums: Sums;

  constructor(private readonly kernels: Kernels, capacity: number) {
    const make = (bytes: number, usage = 0) => {
      const buffer = kernels.buffer(bytes, usage);
      this.made.push(buffer);
      return buffer;
    };
    this.drawn = make(DRAWN * capacity);
    this.seen = make(4 * (capacity + 1));
    this.keys = make(4 * capacity);
    const other = make(4 * capacity);
    const rows = [make(4 * capacity), make(4 * capacity)] as const;
    const blocks = Math.ceil(capacity / BLOCK);
    const counts = make(4 * 256 * blocks);
    this.plan = make(4 * PLAN_WORDS, GPUBufferUsage.UNIFORM | GPUBufferUsage.INDIRECT);
    this.params = kernels.uniform(STRIDE * (1 + LEVELS));
    this.made.push(this.params);
    const own = (place: number) => ({ buffer: this.params, offset: STRIDE * place, size: 16 });
    const found = (place: number) => ({ buffer: this.plan, offset: STRIDE * place, size: 16 });
    this.marks = new Sums(kernels, make, this.seen, capacity + 1, (level) => own(1 + level));
    this.sums = new Sums(kernels, make, counts, 256 * blocks, (level) => found(DIGITS + level));
    this.compact = kernels.call(COMPACT_KEYS, own(0), this.seen, this.keys, other, rows[0]);
    this.planned = kernels.call(PLAN_SORT, own(0), this.seen, this.plan);
    // The keys that were compacted make room for the sorted ones.
    const keys = [other, this.keys] as const;
    for (let digit = 0; digit < DIGITS; digit++) {
      const [from, to] = [digit & 1, (digit + 1) & 1];
      this.digits.push({
        count: kernels.call(RADIX_COUNT, found(digit), keys[from], counts),
        scatter: kernels.call(RADIX_SCATTER, found(digit), keys[from], rows[from], counts, keys[to], rows[to]),
      });
    }
    this.order = rows[DIGITS & 1];
    this.bytes = this.made.reduce((sum, { size }) => sum + size, 0);
  }

  /** Give the device the number of splats, before `encode`. */
  prepare(count: number): void {
    const { queue } = this.kernels.device;
    queue.writeBuffer(this.params, 0, packParams(COMPACT_KEYS, [count]));
    this.marks.counts(count + 1).forEach((each, level) => {
      queue.writeBuffer(this.params, STRIDE * (1 + level), packParams(SCAN, [each]));
    });
  }

  /** Sort what a kernel before it has written of the first `count` splats. */
  encode(pass: GPUComputePassEncoder, count: number): void {
    const { plan } = this;
    this.marks.encode(pass, count + 1);
    run(pass, this.planned, [1, 1]);
    run(pass, this.compact, groupsOf(count));
    for (const digit of this.digits) {
      runPlanned(pass, digit.count, plan, PLAN_GROUPS);
      this.sums.encodePlanned(pass, plan);
      runPlanned(pass, digit.scatter, plan, PLAN_GROUPS);
    }
  }

  close(): void {
    for (const buffer of this.made) buffer.destroy();
  }
}

/** Prefix sums of a buffer in place, level above level of sums of blocks. */
class Sums {
  private readonly scans: Call[] = [];
  private readonly adds: Call[] = [];

  constructor(kernels: Kernels, make: (bytes: number) => GPUBuffer, values: GPUBuffer, most: number, paramsOf: (level: number) => GPUBufferBinding) {
    let [below, size] = [values, most];
    do {
      const level = this.scans.length;
      size = Math.ceil(size / BLOCK);
      const sums = make(4 * size);
      this.scans.push(kernels.call(SCAN, paramsOf(level), below, sums));
      this.adds.push(kernels.call(SCAN_ADD, paramsOf(level), below, sums));
      below = sums;
    } while (size > 1);
  }

  /** Numbers that are summed up on each level. */
  counts(count: number): number[] {
    return this.scans.map((_, level) => Math.ceil(count / BLOCK ** level));
  }

  encode(pass: GPUComputePassEncoder, count: number): void {
    const counts = this.counts(count);
    this.scans.forEach((scan, level) => { run(pass, scan, groupsOf(counts[level], BLOCK)); });
    for (let level = this.scans.length - 2; level >= 0; level--) run(pass, this.adds[level], groupsOf(counts[level]));
  }

  encodePlanned(pass: GPUComputePassEncoder, plan: GPUBuffer): void {
    this.scans.forEach((scan, level) => { runPlanned(pass, scan, plan, PLAN_GROUPS + 3 + 6 * level); });
    for (let level = this.scans.length - 2; level >= 0; level--) runPlanned(pass, this.adds[level], plan, PLAN_GROUPS + 6 + 6 * level);
  }
}
