/** The camera that a person moves: position, orientation, and the point it turns around. */

import { add, cross, dot, rotate, unit } from "../base/vec3";
import type { Vec } from "../base/vec3";
import type { ViewPose } from "../base/view-pose";

/** A pinhole camera: OpenCV axes, pixels; as gsynopsis.scene.camera. */
export interface Pinhole {
  readonly width: number;
  readonly height: number;
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  /** World to camera, rows of [R | t]. */
  readonly w2c: readonly number[]; // [12]
}

/** Position and axes of a camera, and the distance of its pivot. */
export interface Pose {
  readonly position: Vec;
  readonly right: Vec;
  readonly down: Vec;
  readonly forward: Vec;
  /** Distance of the point to turn around. */
  readonly distance: number;
}

/** Limits on a camera's position. */
export interface Limits {
  /** A ball that it does not leave, world units. */
  readonly center: Vec;
  readonly radius: number;
  /** Smallest distance to its pivot, world units. */
  readonly near: number;
}

const PITCH_MAX = 0.995;
const NEAREST = 1e-4;
/** The lens where no photo says otherwise: 50° along the shorter side of a picture of 3 : 2. */
const LENS = [0.69946, 0.46631] as const;

export class Camera {
  pose: Pose;
  /** Half of a photo's width and height at a depth of 1: pictures of any shape show as much as it does. */
  lens: readonly [number, number] | null = null;
  limits: Limits | null = null;
  /** A photo's longer side is the picture's, whichever way it is held; else pictures show as much as the photo. */
  byLonger = false;
  /** To turn is to turn the head. */
  onFoot = false;
  /** Longer side to shorter side of the last picture. */
  private ratio = 1;
  /** Field of view of the shorter side that somebody chose, radians. */
  chosenFov: number | null = null;

  constructor(public up: Vec) {
    this.pose = lookAt([0, 0, -1], [0, 0, 0], up);
  }

  /** Field of view of the shorter side, radians: what was chosen, else one that shows as much as the photo. */
  get fov(): number {
    const { chosenFov, lens, ratio } = this;
    const [across, down] = lens ?? LENS;
    return chosenFov ?? 2 * Math.atan(this.byLonger ? Math.max(across, down) / ratio : Math.sqrt((across * down) / ratio));
  }

  get pivot(): Vec {
    return add(this.pose.position, this.pose.forward, this.pose.distance);
  }

  /** Turn around the pivot: to the right around `up`, upward around the camera's own right. */
  orbit(yaw: number, pitch: number): void {
    if (this.onFoot) this.look(yaw, -pitch);
    else this.turn(yaw, pitch, this.pivot);
  }

  /** Turn the head. */
  look(yaw: number, pitch: number): void {
    this.turn(-yaw, -pitch, this.pose.position);
  }

  private turn(yaw: number, pitch: number, pivot: Vec): void {
    const { pose, up } = this;
    const tilt = rotate(pose.forward, pose.right, pitch);
    const steep = Math.abs(dot(tilt, up)) > PITCH_MAX && Math.abs(dot(tilt, up)) > Math.abs(dot(pose.forward, up));
    const move = (v: Vec) => rotate(steep ? v : rotate(v, pose.right, pitch), up, yaw);
    const arm = add(pose.position, pivot, -1);
    this.pose = {
      ...pose,
      position: add(pivot, move(arm)),
      right: unit(move(pose.right)),
      down: unit(move(pose.down)),
      forward: unit(move(pose.forward)),
    };
    this.hold(pose.position, dot(arm, arm) > 0);
  }

  /**
   * Back within the limits, if a move from `before` left them: ahead, so that what is looked at
   * stays in the middle, or straight inwards where that does not lead there.
   *
   * A camera that was outside already stays as far out as it was. `turns`: the pivot keeps its place.
   */
  private hold(before: Vec, turns: boolean): void {
    const { limits, pose } = this;
    if (!limits) return;
    const far = (v: Vec) => Math.hypot(...add(v, limits.center, -1));
    const most = Math.max(limits.radius, far(before));
    const arm = add(pose.position, limits.center, -1);
    if (far(pose.position) <= most) return;
    // Nearest s > 0 with |arm + s · forward| = most.
    const along = -dot(arm, pose.forward);
    const root = along * along - dot(arm, arm) + most * most;
    const step = along - Math.sqrt(Math.max(root, 0));
    if (root >= 0 && along > 0 && step < pose.distance) {
      const distance = turns ? pose.distance - step : pose.distance;
      this.pose = { ...pose, position: add(pose.position, pose.forward, step), distance };
    } else this.pose = { ...pose, position: add(limits.center, arm, most / far(pose.position)) };
  }

  /** Back within the limits, as far out as may be; the pivot keeps its place. */
  restrain(): void {
    this.hold(this.limits?.center ?? this.pivot, true);
  }

  /** Shift sideways and up, in units of the pivot's distance. */
  pan(x: number, y: number): void {
    const { pose } = this;
    const moved = add(pose.position, pose.right, -x * pose.distance);
    this.pose = { ...pose, position: add(moved, pose.down, -y * pose.distance) };
    this.hold(pose.position, false);
  }

  /** Nearer to the pivot by a factor below 1. */
  zoom(factor: number): void {
    const { pose } = this;
    const near = Math.min(Math.max(this.limits?.near ?? 0, NEAREST), pose.distance);
    const distance = Math.max(pose.distance * factor, near);
    this.pose = { ...pose, distance, position: add(this.pivot, pose.forward, -distance) };
    this.hold(pose.position, true);
  }

  /** Move with the pivot: right, down, forward, world units. */
  fly(x: number, y: number, z: number): void {
    const { pose } = this;
    let position = add(pose.position, pose.right, x);
    position = add(position, pose.down, y);
    this.pose = { ...pose, position: add(position, pose.forward, z) };
    this.hold(pose.position, false);
  }

  /** The pinhole camera of an image of that size. */
  pinhole(width: number, height: number): Pinhole {
    this.ratio = Math.max(width, height) / Math.min(width, height);
    // The field of view is that of the shorter side, so a phone held upright sees as much.
    const focal = Math.min(width, height) / (2 * Math.tan(this.fov / 2));
    return { width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, w2c: w2cOf(this.pose) };
  }
}

export function lookAt(position: Vec, target: Vec, up: Vec): Pose {
  const away = add(target, position, -1);
  const forward = unit(away);
  let right = cross(forward, up);
  if (dot(right, right) < 1e-9) right = cross(forward, [up[1], up[2], up[0]]);
  right = unit(right);
  return { position, right, down: cross(forward, right), forward, distance: Math.sqrt(dot(away, away)) };
}

export function w2cOf({ position, right, down, forward }: Pose): number[] {
  return [right, down, forward].flatMap((axis) => [...axis, -dot(axis, position)]);
}

/** The pose of a world-to-camera matrix, rows of [R | t]. */
export function poseOf(w2c: readonly number[], distance: number): Pose {
  const [right, down, forward] = [0, 4, 8].map((at) => w2c.slice(at, at + 3) as Vec);
  let position: Vec = [0, 0, 0];
  [right, down, forward].forEach((axis, i) => (position = add(position, axis, -w2c[4 * i + 3])));
  return { position, right, down, forward, distance };
}

export function viewPoseOf(camera: Pinhole): ViewPose {
  const { position } = poseOf(camera.w2c, 1);
  return {
    w2c: camera.w2c,
    position,
    right: camera.width / (2 * camera.fx),
    up: camera.height / (2 * camera.fy),
  };
}
