/** The manifest's note `focals`: how large the photos were that each level was trained on. */

import type { Manifest } from "../manifest";

/** Shortest and longest focal length, pixels. */
export type TrainingFocals = readonly [number, number];

/** Focal lengths of a level's training photos; null without a sound note. */
export function trainingFocalsOf(manifest: Manifest | null, level: number): TrainingFocals | null {
  try {
    const values = JSON.parse(manifest?.meta.focals ?? "") as unknown;
    if (!Array.isArray(values) || values.length < manifest!.quality.length || !values.every(areFocals)) return null;
    return values[level] as TrainingFocals;
  } catch {
    return null;
  }
}

function areFocals(value: unknown): boolean {
  if (!Array.isArray(value) || value.length !== 2 || !value.every(Number.isFinite)) return false;
  const [low, high] = value as number[];
  return low > 0 && low <= high;
}
