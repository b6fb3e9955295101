/** Arrays of f32 values from bytes: one branch for each coding (docs/format.md §4). */

import { fromPlanes } from "./codecs";
import { ViewerError, mismatch } from "../base/errors";
import { Coding } from "./layout.gen";

const LARGEST = 3.4028234663852886e38;
const PARAMETER_BYTES = 8;
const CENTRE = 128;

/** Bytes of a value. */
const WIDTHS: Readonly<Record<number, number>> = {
  [Coding.float]: 4,
  [Coding.half]: 2,
  [Coding.affine8]: 1,
  [Coding.affine16]: 2,
  [Coding.curve8]: 1,
};

function widthOf(coding: number): number {
  if (!(coding in WIDTHS)) throw new ViewerError("LayoutError", `unknown coding ${coding}`);
  return WIDTHS[coding];
}

/** True of codings whose arrays begin with the least value and the step of each column. */
function isStepped(coding: number): boolean {
  return coding >= Coding.affine8;
}

/** Bytes of an encoded [rows, columns] array before deflating; 0 if it is empty. */
export function valuesBytes(coding: number, rows: number, columns: number): number {
  const width = widthOf(coding);
  if (!rows || !columns) return 0;
  return (isStepped(coding) ? PARAMETER_BYTES * columns : 0) + rows * columns * width;
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
  const width = widthOf(coding);
  if (isStepped(coding)) {
    decodeStepped(coding, raw, rows, columns, where, out);
    return out;
  }
  const bytes = fromPlanes(raw, rows, columns, width);
  const read = width === 4 ? floats(bytes) : halves(bytes);
  for (let i = 0; i < out.length; i++) {
    out[i] = read(i);
    if (!Number.isFinite(out[i])) throw mismatch("ValueRangeError", where, `${out[i]} in row ${Math.floor(i / columns)}`, "finite values");
  }
  return out;
}

/** True of values that are numbers of steps from a least one. */
export function areSteps(coding: number): boolean {
  return coding === Coding.affine16;
}

/** Numbers of steps [rows, columns], row after row; the least value and the step of each column go into `affine` [columns, 2]. */
export function decodeSteps(raw: Uint8Array, rows: number, affine: Float32Array, where: string): Uint16Array {
  const columns = affine.length / 2;
  for (let column = 0; rows && column < columns; column++) affine.set(parametersOf(raw, column, [0, 65535], where), 2 * column);
  return new Uint16Array(fromPlanes(raw.subarray(PARAMETER_BYTES * columns), rows, columns, 2));
}

function floats(bytes: ArrayBuffer): (i: number) => number {
  const values = new Float32Array(bytes);
  return (i) => values[i];
}

function halves(bytes: ArrayBuffer): (i: number) => number {
  const bits = new Uint16Array(bytes);
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
  if (areSteps(coding)) {
    const affine = new Float32Array(2 * columns);
    const found = decodeSteps(raw, rows, affine, where);
    for (let i = 0; i < found.length; i++) {
      const column = 2 * (i % columns);
      out[i] = affine[column] + affine[column + 1] * found[i];
    }
    return;
  }
  const curved = coding === Coding.curve8;
  let at = PARAMETER_BYTES * columns;
  for (let column = 0; column < columns; column++) {
    const [low, step] = parametersOf(raw, column, [steps(0, curved), steps(255, curved)], where);
    const table = Float32Array.from({ length: 256 }, (_, q) => low + step * steps(q, curved));
    for (let row = 0; row < rows; row++) out[row * columns + column] = table[raw[at++]];
  }
}

/** The least value of a column and its step, with which values of the fewest and the most steps are finite. */
function parametersOf(raw: Uint8Array, column: number, ends: [least: number, most: number], where: string): [low: number, step: number] {
  const view = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
  const [low, step] = [0, 4].map((at) => view.getFloat32(column * PARAMETER_BYTES + at, true));
  if (!(step >= 0 && ends.every((q) => Math.abs(low + step * q) <= LARGEST))) {
    const found = `low ${low} and step ${step} in column ${column}`;
    throw mismatch("ValueRangeError", where, found, "finite values");
  }
  return [low, step];
}

function steps(q: number, curved: boolean): number {
  const c = q - CENTRE;
  return curved ? c + (c * Math.abs(c)) / 64 : q;
}
