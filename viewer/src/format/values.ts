/** Arrays of f32 values from bytes: one branch for each coding (docs/format.md §4). */

import { fromPlanes } from "./codecs";
import { ViewerError, mismatch } from "../base/errors";
import { Coding } from "./layout.gen";

const LARGEST = 3.4028234663852886e38;
const PARAMETER_BYTES = 8;
const CENTRE = 128;

interface CodingRule {
  readonly width: number;
  /** Each column begins with `low` and `step`. */
  readonly stepped: boolean;
}

const RULES: Readonly<Record<number, CodingRule>> = {
  [Coding.float]: { width: 4, stepped: false },
  [Coding.half]: { width: 2, stepped: false },
  [Coding.affine8]: { width: 1, stepped: true },
  [Coding.affine16]: { width: 2, stepped: true },
  [Coding.curve8]: { width: 1, stepped: true },
};

function ruleOf(coding: number): CodingRule {
  if (!(coding in RULES)) throw new ViewerError("LayoutError", `unknown coding ${coding}`);
  return RULES[coding];
}

/** Bytes of an encoded [rows, columns] array before deflating; 0 if it is empty. */
export function valuesBytes(coding: number, rows: number, columns: number): number {
  const rule = ruleOf(coding);
  if (!rows || !columns) return 0;
  return (rule.stepped ? PARAMETER_BYTES * columns : 0) + rows * columns * rule.width;
}

/** The float32 [rows, columns] array, row after row. */
export function decodeValues(
  coding: number,
  raw: Uint8Array,
  rows: number,
  columns: number,
  where: string,
): Float32Array {
  const out = new Float32Array(rows * columns);
  if (!out.length) return out;
  if (ruleOf(coding).stepped) {
    decodeStepped(coding, raw, rows, columns, where, out);
    return out;
  }
  const { width } = ruleOf(coding);
  const planes = fromPlanes(raw, rows, columns, width);
  const read = width === 4 ? floats(planes) : halves(planes);
  for (let column = 0, i = 0; column < columns; column++) {
    for (let row = 0; row < rows; row++, i++) {
      const value = read(i);
      if (!Number.isFinite(value)) {
        throw mismatch("ValueRangeError", where, `${value} in row ${row}`, "finite values");
      }
      out[row * columns + column] = value;
    }
  }
  return out;
}

function floats(planes: ArrayBuffer): (i: number) => number {
  const values = new Float32Array(planes);
  return (i) => values[i];
}

function halves(planes: ArrayBuffer): (i: number) => number {
  const bits = new Uint16Array(planes);
  return (i) => halfToFloat(bits[i]);
}

/** The value of a binary16 number. */
export function halfToFloat(bits: number): number {
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  const sign = bits & 0x8000 ? -1 : 1;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

function decodeStepped(
  coding: number,
  raw: Uint8Array,
  rows: number,
  columns: number,
  where: string,
  out: Float32Array,
): void {
  const view = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const wide = coding === Coding.affine16;
  const curved = coding === Coding.curve8;
  const top = wide ? 65535 : 255;
  let at = PARAMETER_BYTES * columns;
  for (let column = 0; column < columns; column++) {
    const low = view.getFloat32(column * PARAMETER_BYTES, true);
    const step = view.getFloat32(column * PARAMETER_BYTES + 4, true);
    const ends = [0, top].map((q) => Math.abs(low + step * steps(q, curved)));
    if (!(step >= 0 && ends[0] <= LARGEST && ends[1] <= LARGEST)) {
      const found = `low ${low} and step ${step} in column ${column}`;
      throw mismatch("ValueRangeError", where, found, "finite values");
    }
    if (wide) {
      for (let row = 0; row < rows; row++) {
        const q = raw[at + row] | (raw[at + rows + row] << 8);
        out[row * columns + column] = low + step * q;
      }
    } else {
      const table = Float32Array.from({ length: 256 }, (_, q) => low + step * steps(q, curved));
      for (let row = 0; row < rows; row++) out[row * columns + column] = table[raw[at + row]];
    }
    at += rows * (wide ? 2 : 1);
  }
}

function steps(q: number, curved: boolean): number {
  const c = q - CENTRE;
  return curved ? c + (c * Math.abs(c)) / 64 : q;
}
