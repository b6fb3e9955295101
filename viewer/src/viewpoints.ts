/** Where a scene is looked at from: the circle of its own cameras that a file carries. */

import { add, cross, dot, lookAt, unit } from "./camera";
import type { Pose, Vec } from "./camera";
import type { SceneFacts } from "./messages";

/** A round flight: where it looks, which way is up, how far and how high it flies. */
export interface Circle {
  readonly target: Vec;
  readonly up: Vec;
  /** From the axis to the first camera, at right angles to `up`. */
  readonly ahead: Vec;
  readonly radius: number;
  readonly height: number;
}

/** Places on the circle to step through. */
export const STATIONS = 8;
/** `extent` is this much more than the distance of the farthest camera. */
const CAMERA_MARGIN = 1.1;
const TILT = (20 * Math.PI) / 180;

/** The circle of the file's notes, else one around the middle of its frame. */
export function circleOf(facts: SceneFacts): Circle {
  return parseCircle(facts.manifest?.meta.orbit) ?? circleOfFrame(facts);
}

export function circleOfFrame(facts: SceneFacts): Circle {
  const distance = facts.extent / CAMERA_MARGIN;
  return {
    target: [...facts.center],
    up: [0, -1, 0],
    ahead: [0, 0, -1],
    radius: distance * Math.cos(TILT),
    height: distance * Math.sin(TILT),
  };
}

/** The circle in a file's note; null if it is not one that can be flown. */
export function parseCircle(text: string | undefined): Circle | null {
  if (text === undefined) return null;
  let values: Record<string, unknown>;
  try {
    values = JSON.parse(text) as Record<string, unknown>;
    const [target, up, ahead] = ["target", "up", "ahead"].map((name) => numbers(values[name], 3));
    const [[radius], [height]] = ["radius", "height"].map((name) => numbers(values[name], 1));
    if (radius < 0 || !dot(up as Vec, up as Vec)) return null;
    const axis = unit(up as Vec);
    const across = add(ahead as Vec, axis, -dot(ahead as Vec, axis));
    const flat = dot(across, across) > 1e-12 ? across : cross(axis, [axis[1], axis[2], axis[0]]);
    return { target: target as Vec, up: axis, ahead: unit(flat), radius, height };
  } catch {
    return null;
  }
}

function numbers(value: unknown, count: number): number[] {
  const list = (Array.isArray(value) ? value : []) as unknown[];
  if (list.length !== count || !list.every((v) => Number.isFinite(v))) throw new Error("no numbers");
  return list as number[];
}

/** The camera at a place of the circle, 0 … 1 around it. */
export function poseOnCircle(circle: Circle, turn: number): Pose {
  const { target, up, ahead, radius, height } = circle;
  const side = cross(up, ahead);
  const angle = 2 * Math.PI * turn;
  let eye = add(target, ahead, radius * Math.cos(angle));
  eye = add(eye, side, radius * Math.sin(angle));
  return lookAt(add(eye, up, height), target, up);
}
