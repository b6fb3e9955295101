/** The manifest's note `annotations`: titles and texts at places of a scene; as container/notes/annotations.py. */

import type { Vec } from "../../base/vec3";
import type { Manifest } from "../manifest";

export interface Annotation {
  readonly title: string;
  readonly text: string;
  /** World units. */
  readonly at: Vec;
  /** As the element's `camera`. */
  readonly camera: { readonly position: Vec; readonly target: Vec; readonly quaternion: [number, number, number, number] };
}

export const ANNOTATIONS_MAX = 100;
export const TITLE_MAX = 100;
export const TEXT_MAX = 2000;
/** No number of a note is larger. */
const FAR = 2 ** 60;

/** Annotations of a file; none without a sound note. */
export function annotationsOf(manifest: Manifest | null): Annotation[] {
  try {
    const values = JSON.parse(manifest?.meta.annotations ?? "") as unknown;
    return Array.isArray(values) && values.length <= ANNOTATIONS_MAX && values.every(isAnnotation) ? values : [];
  } catch {
    return [];
  }
}

function isAnnotation(value: unknown): value is Annotation {
  const { title, text, at, camera } = value as Annotation;
  const { position, target, quaternion } = camera;
  return areWords(title, TITLE_MAX) && areWords(text, TEXT_MAX) && [at, position, target].every((place) => areNumbers(place, 3))
    && areNumbers(quaternion, 4) && quaternion.some(Boolean);
}

function areWords(value: unknown, most: number): boolean {
  return typeof value === "string" && value.length <= most;
}

function areNumbers(values: unknown, count: number): boolean {
  return Array.isArray(values) && values.length === count && values.every((v) => Number.isFinite(v) && Math.abs(v as number) <= FAR);
}
