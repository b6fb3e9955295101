/** The kernels in plain JavaScript: the oracle of wasm/kernel.c and its fallback. */

import { ALPHA_MIN, BATCH, SLOT_VALUES } from "./kernel";
import type { Batch, Kernel, Slots } from "./kernel";
import type { GridTable, Layer, PackedNetworks } from "../packed-networks";

const f = Math.fround;

export class PlainKernel implements Kernel {
  readonly name = "plain";

  features(part: PackedNetworks, batch: Batch, out: Float32Array): void {
    const { width, gridFeatures, codeWidth, residual } = part;
    const n = batch.count;
    const x = new Float32Array(n * width);
    part.grids.forEach((grid, g) => {
      gather(batch.u, n, grid, gridFeatures, x, g * gridFeatures, width);
    });
    const at = part.grids.length * gridFeatures;
    for (let i = 0; i < n; i++) {
      const code = batch.codes[i] * codeWidth;
      x.set(part.codebook.subarray(code, code + codeWidth), i * width + at);
      const own = batch.residual.subarray(i * residual, (i + 1) * residual);
      x.set(own, i * width + at + codeWidth);
    }
    let inputs = x;
    let stride = width;
    part.fuse.forEach((layer, k) => {
      const next = new Float32Array(n * layer.outs);
      dense({ x: inputs, n, stride }, layer, layer.start, false, k === 0, next);
      inputs = next;
      stride = layer.outs;
    });
    dense({ x: inputs, n, stride }, part.first, part.first.start, false, false, out);
  }

  heads(part: PackedNetworks, n: number, hidden: Float32Array, view: Float32Array, slots: Slots, out: Float32Array): void {
    const inner = new Float32Array(BATCH * part.view.outs);
    dense({ x: view, n, stride: 4 }, part.view, hidden, true, true, inner);
    const [ow, ob, vw, vb, cw, cb] = part.heads;
    const width = part.hidden;
    for (let i = 0, to = 0; i < slots.count; i++, to += SLOT_VALUES) {
      const h = slots.owners[i] * 3 * width;
      const slot = slots.slots[i];
      const o = dot(inner, h, ow, slot * width, width, ob[slot]);
      out[to] = f(1 - f(2 / f(exponential(f(2 * o)) + 1)));
      if (!(out[to] >= ALPHA_MIN)) continue;
      let norm = 0;
      for (let k = 0; k < 7; k++) {
        const row = slot * 7 + k;
        const v = dot(inner, h + width, vw, row * width, width, vb[row]);
        if (k >= 3) norm = f(norm + f(v * v));
        out[to + 1 + k] = k < 3 ? sigmoid(v) : v;
      }
      norm = Math.max(f(Math.sqrt(norm)), f(1e-12));
      for (let k = 4; k < 8; k++) out[to + k] = f(out[to + k] / norm);
      for (let k = 0; k < 3; k++) {
        const row = slot * 3 + k;
        out[to + 8 + k] = sigmoid(dot(inner, h + 2 * width, cw, row * width, width, cb[row]));
      }
    }
  }
}

/** Trilinear features of one grid, row i at out[at + i · stride]. */
function gather(
  u: Float32Array,
  n: number,
  grid: GridTable,
  features: number,
  out: Float32Array,
  at: number,
  stride: number,
): void {
  const { resolution: r, rows, table } = grid;
  const isDense = r ** 3 <= rows;
  const low = [0, 0, 0];
  const high = [0, 0, 0];
  const part = [0, 0, 0];
  for (let i = 0, to = at; i < n; i++, to += stride) {
    for (let a = 0; a < 3; a++) {
      const p = f(u[3 * i + a] * f(r - 1));
      const cell = Math.min(Math.trunc(p), Math.max(r - 2, 0));
      part[a] = f(p - cell);
      low[a] = cell;
      high[a] = Math.min(cell + 1, r - 1);
    }
    for (let c = 0; c < 8; c++) {
      const x = (c & 1 ? high : low)[0];
      const y = (c & 2 ? high : low)[1];
      const z = (c & 4 ? high : low)[2];
      const wx = c & 1 ? part[0] : f(1 - part[0]);
      const wy = c & 2 ? part[1] : f(1 - part[1]);
      const w = f(f(wx * wy) * (c & 4 ? part[2] : f(1 - part[2])));
      const hashed = (x ^ Math.imul(y, 2654435761) ^ Math.imul(z, 805459861)) >>> 0;
      const row = (isDense ? x + r * (y + r * z) : hashed % rows) * features;
      for (let k = 0; k < features; k++) out[to + k] = f(out[to + k] + f(table[row + k] * w));
    }
  }
}

/** Row i of n begins at x[i · stride]. */
interface Inputs {
  readonly x: Float32Array;
  readonly n: number;
  readonly stride: number;
}

/** out = relu?(start + x · weights); `start` is one row, or one for each of n where `rows`. */
function dense(
  { x, n, stride }: Inputs,
  layer: Layer,
  start: Float32Array,
  rows: boolean,
  relu: boolean,
  out: Float32Array,
): void {
  const { ins, outs, weights } = layer;
  const sums = new Float32Array(outs);
  for (let i = 0; i < n; i++) {
    sums.set(rows ? start.subarray(i * outs, (i + 1) * outs) : start);
    for (let j = 0; j < ins; j++) {
      const v = x[i * stride + j];
      const w = j * outs;
      for (let o = 0; o < outs; o++) sums[o] = f(sums[o] + f(weights[w + o] * v));
    }
    if (relu) for (let o = 0; o < outs; o++) if (!(sums[o] > 0)) sums[o] = 0;
    out.set(sums, i * outs);
  }
}

/** In four lanes, then the lanes pairwise, then the bias, as SIMD does. */
function dot(a: Float32Array, i: number, b: Float32Array, j: number, width: number, bias: number): number {
  let [s0, s1, s2, s3] = [0, 0, 0, 0];
  for (let k = 0; k < width; k += 4) {
    s0 = f(s0 + f(a[i + k] * b[j + k]));
    s1 = f(s1 + f(a[i + k + 1] * b[j + k + 1]));
    s2 = f(s2 + f(a[i + k + 2] * b[j + k + 2]));
    s3 = f(s3 + f(a[i + k + 3] * b[j + k + 3]));
  }
  return f(f(f(s0 + s2) + f(s1 + s3)) + bias);
}

const [LOG2E, LN2_HIGH, LN2_LOW] = [1.44269504, 0.693359375, -2.1219444e-4].map(f);
const SERIES = [1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1].map(f);
const FIRST = f(1.98756915e-4);

/** e^x in float32 arithmetic, operation by operation as in wasm/kernel.c. */
function exponential(value: number): number {
  const x = Math.min(87, Math.max(-87, value));
  const n = Math.floor(f(f(x * LOG2E) + 0.5));
  const r = f(f(x - f(n * LN2_HIGH)) - f(n * LN2_LOW));
  let p = FIRST;
  for (const c of SERIES) p = f(f(p * r) + c);
  p = f(f(f(p * f(r * r)) + r) + 1);
  return f(p * 2 ** n);
}

function sigmoid(x: number): number {
  return f(1 / f(1 + exponential(f(-x))));
}
