/** Records of the file as objects of numbers, each field in its range. */

import { ViewerError, mismatch } from "../base/errors";
import type { Field } from "./layout.gen";

export type Numbers<T> = { readonly [K in keyof T]: number };

/** Read one record at `at`; u64 fields beyond 2^53 lose digits but stay out of range. */
export function readRecord<T extends Record<string, Field>>(
  view: DataView,
  at: number,
  fields: T,
): Numbers<T> {
  const record: Record<string, number> = {};
  for (const name in fields) {
    record[name] = readField(view, at + fields[name].offset, fields[name].type);
  }
  return record as Numbers<T>;
}

export function readField(view: DataView, at: number, type: Field["type"]): number {
  switch (type) {
    case "u8":
      return view.getUint8(at);
    case "u16":
      return view.getUint16(at, true);
    case "u32":
      return view.getUint32(at, true);
    case "i32":
      return view.getInt32(at, true);
    case "u64":
      return view.getUint32(at + 4, true) * 2 ** 32 + view.getUint32(at, true);
    case "f32":
      return view.getFloat32(at, true);
    case "f64":
      return view.getFloat64(at, true);
    case "bytes":
      return 0;
  }
}

/** Every field lies in the range that the layout gives it. */
export function checkRanges<T extends Record<string, Field>>(
  record: Numbers<T>,
  fields: T,
  where: string,
): void {
  for (const name in fields) {
    const { type, low, high } = fields[name];
    const value = record[name];
    if (type === "f32" || type === "f64") {
      if (!Number.isFinite(value) || value < low || value > high) {
        const expected = Number.isFinite(high) ? `${low} to ${high}` : "finite and > 0";
        throw mismatch("ValueRangeError", `${where}: ${name}`, value, expected);
      }
    } else if (type !== "bytes" && (value < low || value > high)) {
      throw mismatch("LayoutError", `${where}: ${name}`, value, `${low} to ${high}`);
    }
  }
}

export function expectEqual(found: number, expected: number, where: string): void {
  if (found !== expected) throw mismatch("LayoutError", where, found, expected);
}

/** A value that a checked table promises to be there. */
export function must<T>(value: T | undefined, where: string): T {
  if (value === undefined) throw new ViewerError("LayoutError", `${where}: nothing there`);
  return value;
}
