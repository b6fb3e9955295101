/** First view and circle of cameras of a scene, from the notes of its file. */

import { add, cross, dot, unit } from "../base/vec3";
import { lookAt, poseOf } from "./camera";
import type { Camera, Limits, Pose } from "./camera";
import type { Vec } from "../base/vec3";
import type { SceneFacts } from "../decode/messages";
import { viewBoundsOf } from "../format/notes/view-bounds";

/** A round flight: where it looks, which way is up, how far and how high it flies. */
export interface Circle {
  readonly target: Vec;
  readonly up: Vec;
  /** Direction from the axis to the first camera, at right angles to `up`. */
  readonly ahead: Vec;
  readonly radius: number;
  readonly height: number;
  /** The part that was captured, angles from `ahead` around `up`; null: all of it. */
  readonly arc: readonly [number, number] | null;
}

/** The pose of a photo, and half of its width and height at a depth of 1. */
export interface FirstView {
  readonly pose: Pose;
  readonly lens: readonly [number, number];
}

/** Places on the circle to step through. */
export const STATIONS = 8;
/** `extent` is this much more than the distance of the farthest camera. */
const CAMERA_MARGIN = 1.1;
const TILT = (20 * Math.PI) / 180;
/** An arc of so many radians is a circle. */
const FULL_TURN = 2 * Math.PI - 1e-3;
/** The camera may go so much farther from what is looked at than the cameras of training. */
const ROOM = 1.5;
/** Nearest distance to the pivot, as a share of the smallest distance in training. */
const CLOSE = 0.25;
/** Rows of a rotation may be so far from unit length and right angles. */
const SKEW = 1e-3;
/** No number of a note is larger. */
const FAR = 2 ** 60;

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
    arc: null,
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
    const [low, high] = values.arc === undefined ? [-Math.PI, Math.PI] : numbers(values.arc, 2);
    if (radius < 0 || low > high || !dot(up as Vec, up as Vec)) return null;
    const axis = unit(up as Vec);
    const across = add(ahead as Vec, axis, -dot(ahead as Vec, axis));
    const flat = dot(across, across) > 1e-12 ? across : cross(axis, [axis[1], axis[2], axis[0]]);
    const arc = high - low < FULL_TURN ? ([low, high] as const) : null;
    return { target: target as Vec, up: axis, ahead: unit(flat), radius, height, arc };
  } catch {
    return null;
  }
}

function numbers(value: unknown, count: number): number[] {
  const list = (Array.isArray(value) ? value : []) as unknown[];
  if (list.length !== count || !list.every((v) => Number.isFinite(v) && Math.abs(v as number) <= FAR)) throw new Error("no numbers");
  return list as number[];
}

/** The photo of the file's note; null if there is none. */
export function firstView(facts: SceneFacts): FirstView | null {
  try {
    const values = JSON.parse(facts.manifest?.meta.first ?? "") as Record<string, unknown>;
    const [w2c, half] = [numbers(values.w2c, 12), numbers(values.half, 2)];
    const pose = poseOf(w2c, 1);
    const { right, down, forward } = pose;
    const skew = [dot(right, right) - 1, dot(down, down) - 1, ...add(cross(right, down), forward, -1)];
    if (!skew.every((value) => Math.abs(value) < SKEW) || !(Math.min(...half) > 0)) return null;
    const { target, radius } = circleOf(facts);
    const distance = dot(add(target, pose.position, -1), forward);
    const ahead = distance > 0.1 * radius ? distance : radius || 1;
    return { pose: { ...pose, distance: ahead }, lens: [half[0], half[1]] };
  } catch {
    return null;
  }
}

/** Put a camera at a place of a round, 0 … 1: 0 is the first view, a photo's where one is known. */
export function visitStation(camera: Camera, facts: SceneFacts, turn: number, free: boolean): void {
  const [circle, first] = [circleOf(facts), firstView(facts)];
  camera.limits = free ? null : limitsOf(facts);
  camera.up = circle.up;
  camera.lens = first?.lens ?? null;
  camera.chosenFov = null;
  camera.pose = first && !turn ? first.pose : poseOnCircle(circle, turn);
}

/** Limits of the camera: a ball around the target that holds the cameras, and half as much more. */
export function limitsOf(facts: SceneFacts): Limits {
  const { target, radius, height } = circleOf(facts);
  const seen = viewBoundsOf(facts.manifest);
  const farthest = seen ? Math.hypot(...add(seen.center, target, -1)) + seen.radius : Math.hypot(radius, height) + facts.extent;
  return { center: target, radius: ROOM * farthest, near: CLOSE * (seen?.low ?? 0) * facts.extent };
}

/** The camera at a place of a round, 0 … 1; where the circle is open, from the middle to both ends and back. */
export function poseOnCircle(circle: Circle, turn: number): Pose {
  const { target, up, ahead, radius, height, arc } = circle;
  const side = cross(up, ahead);
  let angle = 2 * Math.PI * turn;
  if (arc) {
    const wave = 1 - Math.abs(4 * ((turn + 0.25) % 1) - 2);
    angle = (arc[0] + arc[1]) / 2 + ((arc[1] - arc[0]) / 2) * wave;
  }
  let eye = add(target, ahead, radius * Math.cos(angle));
  eye = add(eye, side, radius * Math.sin(angle));
  return lookAt(add(eye, up, height), target, up);
}
