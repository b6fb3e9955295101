/** A splat's own values as a Gaussian seen from a point (docs/format.md §5). */

import type { Assembler } from "../format/assembler";
import type { Vec } from "../base/vec3";
import { codesOf, ownerOf } from "../format/file-index";
import { latticePosition } from "../format/lattice";
import { SPLAT_SCALES, SPLAT_VALUES } from "../format/layout.gen";
import { must } from "../format/records";

/** Constants of the spherical harmonics of 3DGS: the first, and the factors of the others. */
const C0 = 0.28209479177387814;
const C1 = 0.4886025119029199;
const C2 = [1.0925484305920792, 0.31539156525252005, 0.5462742152960396];
const C3 = [0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277];
const BASES = 16;
const COLUMNS = SPLAT_SCALES + SPLAT_VALUES;
const GAINS = ["gain_x", "gain_y", "gain_z"] as const;

/** Values of the bases of degree 0 to 3 for a unit direction, into `out`. Nothing is allocated. */
export function bases(x: number, y: number, z: number, out: Float64Array): void {
  const xx = x * x;
  const yy = y * y;
  const zz = z * z;
  out[0] = C0;
  out[1] = -C1 * y;
  out[2] = C1 * z;
  out[3] = -C1 * x;
  out[4] = C2[0] * x * y;
  out[5] = -C2[0] * y * z;
  out[6] = C2[1] * (2 * zz - xx - yy);
  out[7] = -C2[0] * x * z;
  out[8] = C2[2] * (xx - yy);
  out[9] = -C3[0] * y * (3 * xx - yy);
  out[10] = C3[1] * x * y * z;
  out[11] = -C3[2] * y * (4 * zz - xx - yy);
  out[12] = C3[3] * z * (2 * zz - 3 * xx - 3 * yy);
  out[13] = -C3[2] * x * (4 * zz - xx - yy);
  out[14] = C3[4] * z * (xx - yy);
  out[15] = -C3[0] * x * (xx - 3 * yy);
}

/** The Gaussians of an assembler's splats. */
export class SplatDecoder {
  private readonly weights = new Float64Array(BASES);
  /** Logarithms of scales, rotation, logit of opacity and colour of the splat read last. */
  private readonly values = new Float32Array(COLUMNS);
  /** Number of codes of a level's splats, and the level of their codebook, by level. */
  private readonly used: readonly number[];
  private readonly owners: readonly number[];

  constructor(private readonly assembler: Assembler) {
    const { index } = assembler;
    this.used = index.levels.map((_, level) => codesOf(index, level));
    this.owners = index.levels.map((_, level) => ownerOf(index, level));
  }

  /** A stand-in, where its level is one that shows others in its place. */
  isReplaced(row: number, level: number): boolean {
    const { stand_ins } = this.assembler.index.header;
    return this.assembler.tables.brought[row] < stand_ins && level >= stand_ins;
  }

  /** Splats of coarser levels look otherwise at this level than at the one before. */
  changesAt(level: number): boolean {
    const { header, levels } = this.assembler.index;
    return level === header.stand_ins || GAINS.some((gain) => levels[level][gain] !== levels.at(level - 1)?.[gain]);
  }

  /** Colors depend on the direction. */
  get turns(): boolean {
    return this.assembler.index.header.features > 0;
  }

  /**
   * Opacity, scales, quaternion and colour of a splat at a level, seen from `eye`, into `out` [11].
   *
   * A value that is not finite makes the opacity 0.
   */
  decode(row: number, level: number, eye: Readonly<Vec>, out: Float32Array): void {
    const entry = this.assembler.index.levels[level];
    this.read(row);
    const { values } = this;
    const x = values[3];
    const y = values[4];
    const z = values[5];
    const square = x * x + y * y + z * z;
    const turn = 2 / (1 + square);
    out[0] = 1 / (1 + Math.exp(-values[6]));
    out[1] = Math.exp(values[0]) * entry.gain_x;
    out[2] = Math.exp(values[1]) * entry.gain_y;
    out[3] = Math.exp(values[2]) * entry.gain_z;
    out[4] = turn - 1;
    out[5] = turn * x;
    out[6] = turn * y;
    out[7] = turn * z;
    this.color(row, eye, out);
    for (let i = 1; i < 11; i++) if (!Number.isFinite(out[i])) out[0] = 0;
  }

  /** A splat's own values as they are in the file. */
  private read(row: number): void {
    const { affine, tables: { logScales, residual, block } } = this.assembler;
    const steps = affine[block[row]];
    for (let i = 0; i < COLUMNS; i++) {
      const value = i < SPLAT_SCALES ? logScales[SPLAT_SCALES * row + i] : residual[SPLAT_VALUES * row + i - SPLAT_SCALES];
      this.values[i] = steps[2 * i] + steps[2 * i + 1] * value;
    }
  }

  private color(row: number, eye: Readonly<Vec>, out: Float32Array): void {
    const { codebooks, stages, tables } = this.assembler;
    const { lattice, codes, brought: levels } = tables;
    const { values } = this;
    const rest = values[7] - values[9];
    let r = 0.5 + C0 * (rest + values[8]);
    let g = 0.5 + C0 * (values[7] + values[9]);
    let b = 0.5 + C0 * (rest - values[8]);
    const { features, voxel } = this.assembler.index.header;
    const brought = levels[row];
    const used = this.used[brought];
    if (features && used) {
      const x = latticePosition(lattice[3 * row], voxel) - eye[0];
      const y = latticePosition(lattice[3 * row + 1], voxel) - eye[1];
      const z = latticePosition(lattice[3 * row + 2], voxel) - eye[2];
      const far = Math.max(Math.sqrt(x * x + y * y + z * z), 1e-8);
      const { weights } = this;
      bases(x / far, y / far, z / far, weights);
      const book = must(codebooks.get(this.owners[brought]), "codebook");
      for (let stage = 0; stage < used; stage++) {
        const from = (codes[stages * row + stage] * used + stage) * features;
        for (let i = 0; i < features; i += 3) {
          const weight = weights[1 + i / 3];
          r += weight * book[from + i];
          g += weight * book[from + i + 1];
          b += weight * book[from + i + 2];
        }
      }
    }
    out[8] = Math.max(0, r);
    out[9] = Math.max(0, g);
    out[10] = Math.max(0, b);
  }
}
