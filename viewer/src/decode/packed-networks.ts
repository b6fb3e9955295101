/** A level's networks in the order in which the kernels read them. */

import type { Networks } from "../format/assembler";
import { HEADS, VIEW_INPUTS, inputWidth } from "../format/file-index";
import type { Header, LevelEntry } from "../format/file-index";

/** One affine layer, weights [ins, outs] with outs a multiple of 4. */
export interface Layer {
  readonly ins: number;
  readonly outs: number;
  readonly weights: Float32Array;
  readonly start: Float32Array;
}

export interface GridTable {
  readonly table: Float32Array;
  readonly rows: number;
  readonly resolution: number;
}

export interface PackedNetworks {
  readonly level: number;
  /** Width of features: grids, codebook, residual. */
  readonly width: number;
  readonly gridFeatures: number;
  readonly grids: readonly GridTable[];
  readonly codebook: Float32Array;
  readonly codeWidth: number;
  readonly residual: number;
  /** The fusion MLP, or nothing. */
  readonly fuse: readonly Layer[];
  /** First layers of the heads side by side, without their view inputs. */
  readonly first: Layer;
  /** Their view inputs. */
  readonly view: Layer;
  /** Hidden width of one head, a multiple of 4. */
  readonly hidden: number;
  readonly slots: number;
  /** Second layers: weights [outputs · K, hidden] and bias of opacity, cov and color. */
  readonly heads: readonly Float32Array[];
  readonly gain: readonly [number, number, number];
}

export function round4(n: number): number {
  return (n + 3) & ~3;
}

/** Networks of a level, given by name, in the order of the kernel. */
export function packNetworks(
  level: number,
  header: Header,
  entry: LevelEntry,
  networks: Networks,
  codebook: Float32Array,
  grids: readonly GridTable[],
): PackedNetworks {
  const get = (name: string) => networks.get(name) ?? new Float32Array(0);
  const width = inputWidth(header, entry);
  const fuse = entry.fuse_hidden
    ? [
        layer([[get("fuse_w1"), get("fuse_b1")]], entry.fuse_hidden, width, 0, width),
        layer([[get("fuse_w2"), get("fuse_b2")]], entry.fuse_out, entry.fuse_hidden, 0, entry.fuse_hidden),
      ]
    : [];
  const ins = entry.fuse_hidden ? entry.fuse_out : width;
  const inner = entry.head_hidden;
  const nets = HEADS.map(([head]): [Float32Array, Float32Array] => [get(`${head}_w1`), get(`${head}_b1`)]);
  const columns = ins + VIEW_INPUTS;
  return {
    level,
    width,
    gridFeatures: header.features,
    grids,
    codebook,
    codeWidth: entry.codebook_columns,
    residual: header.residual,
    fuse,
    first: layer(nets, inner, columns, 0, ins),
    view: layer(nets, inner, columns, ins, columns),
    hidden: round4(inner),
    slots: header.slots,
    heads: HEADS.flatMap(([head]) => [padRows(get(`${head}_w2`), inner), get(`${head}_b2`)]),
    gain: [entry.gain_x, entry.gain_y, entry.gain_z],
  };
}

/** Input columns `from`…`to` of nets side by side, each padded to a multiple of 4 outputs. */
function layer(
  nets: readonly [Float32Array, Float32Array][],
  outs: number,
  columns: number,
  from: number,
  to: number,
): Layer {
  const padded = round4(outs);
  const all = padded * nets.length;
  const weights = new Float32Array((to - from) * all);
  const start = new Float32Array(all);
  nets.forEach(([matrix, bias], net) => {
    start.set(bias, net * padded);
    for (let o = 0; o < outs; o++) {
      for (let i = from; i < to; i++) {
        weights[(i - from) * all + net * padded + o] = matrix[o * columns + i];
      }
    }
  });
  return { ins: to - from, outs: all, weights, start };
}

function padRows(matrix: Float32Array, columns: number): Float32Array {
  const padded = round4(columns);
  const rows = matrix.length / columns;
  const out = new Float32Array(rows * padded);
  for (let row = 0; row < rows; row++) {
    out.set(matrix.subarray(row * columns, (row + 1) * columns), row * padded);
  }
  return out;
}
