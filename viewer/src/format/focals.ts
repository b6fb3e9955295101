/** How large the photos were that a level was trained on, and what that means for a picture. */

import type { Manifest } from "./manifest";

/** Shortest and longest focal length, pixels. */
export type Focals = readonly [number, number];

/** px² that training adds to the diagonal of each projected covariance. */
const DILATION = 0.3;

/** What the file's note says of a level; null if there is no such note. */
export function focalsOf(manifest: Manifest | null, level: number): Focals | null {
  try {
    const values = JSON.parse(manifest?.meta.focals ?? "") as unknown;
    if (!Array.isArray(values) || values.length < manifest!.quality.length || !values.every(areFocals)) return null;
    return values[level] as Focals;
  } catch {
    return null;
  }
}

function areFocals(value: unknown): boolean {
  if (!Array.isArray(value) || value.length !== 2 || !value.every(Number.isFinite)) return false;
  const [low, high] = value as number[];
  return low > 0 && low <= high;
}

/** px² on the diagonal of covariances: a Gaussian's own, and all; as render.base.dilations. */
export function dilations(focals: Focals | null, fx: number, fy: number): [number, number] {
  if (!focals) return [DILATION, DILATION];
  const here = Math.sqrt(fx * fy);
  const ratio = here / Math.min(Math.max(here, focals[0]), focals[1]);
  const own = DILATION * ratio * ratio;
  return [own, Math.max(own, DILATION)];
}
