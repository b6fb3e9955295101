/** The manifest's note `seen`: the views of training (docs/format.md §3). The heads are evaluated for no others. */

import { add, dot } from "../../base/vec3";
import type { Vec } from "../../base/vec3";
import type { Manifest } from "../manifest";

export interface ViewBounds {
  /** A ball that holds the cameras of training, world units. */
  readonly center: Vec;
  readonly radius: number;
  /** Smallest and largest distance input, in units of the frame's extent, float32. */
  readonly low: number;
  readonly high: number;
}

/** The bounds of a file; null without a sound note. */
export function viewBoundsOf(manifest: Manifest | null): ViewBounds | null {
  try {
    const { center, radius, distance } = JSON.parse(manifest?.meta.seen ?? "") as Record<string, unknown>;
    if (!areNumbers(center, 3) || !areNumbers([radius], 1) || !areNumbers(distance, 2)) return null;
    const [low, high] = distance.map(Math.fround);
    if (!((radius as number) > 0 && low >= 0 && low <= high && high < Infinity)) return null;
    return { center: center as Vec, radius: radius as number, low, high };
  } catch {
    return null;
  }
}

function areNumbers(values: unknown, count: number): values is number[] {
  return Array.isArray(values) && values.length === count && values.every(Number.isFinite);
}

/** The eye itself within the ball, else the point of the ball nearest to it; as Seen.nearest in Python. */
export function clampToBounds(seen: ViewBounds, eye: Vec): Vec {
  const away = add(eye, seen.center, -1);
  const far = Math.sqrt(dot(away, away));
  return far <= seen.radius ? eye : add(seen.center, away, seen.radius / far);
}
