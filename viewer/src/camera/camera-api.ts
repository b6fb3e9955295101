/** The camera as other scripts see it, in the units and axes of the scene's photos. */

import { add, cross, unit } from "../base/vec3";
import { lookAt } from "./camera";
import type { Camera, Pose } from "./camera";
import type { Vec } from "../base/vec3";

type Triple = readonly [number, number, number];

export interface ViewerCamera {
  /** World units. */
  readonly position: Triple;
  /** The point that it looks at and turns around. */
  readonly target: Triple;
  /** (w, x, y, z), turns the camera's axes (x right, y down, z forward) to the world's. */
  readonly quaternion: readonly [number, number, number, number];
  /** Field of view along the shorter side, radians. */
  readonly fov: number;
}

/** Milliseconds between two `camera-change`, at least. */
const NEWS_EVERY = 100;

export function cameraState({ pose, pivot, fov }: Camera): ViewerCamera {
  return { position: [...pose.position], target: pivot, quaternion: quaternionOf(pose), fov };
}

/**
 * Put the camera somewhere; what is not given stays. A quaternion decides where it looks, and a target
 * beside it only how far away the point is that it turns around; without one a target is looked at.
 */
export function placeCamera(camera: Camera, wanted: Partial<ViewerCamera>): void {
  const { pose } = camera;
  const position = [...numbers(wanted.position ?? pose.position, 3)] as Vec;
  const fov = wanted.fov ?? camera.fov;
  if (!(fov > 0 && fov < Math.PI)) throw new RangeError(`fov: found ${fov}, expected radians between 0 and π`);
  const target = wanted.target && ([...numbers(wanted.target, 3)] as Vec);
  const distance = target ? Math.hypot(...add(target, position, -1)) : pose.distance;
  if (!(distance > 0)) throw new RangeError("target: found the position, expected another point");
  if (wanted.quaternion) camera.pose = { position, ...axesOf(numbers(wanted.quaternion, 4)), distance };
  else if (target) camera.pose = lookAt(position, target, camera.up);
  else camera.pose = { ...pose, position };
  if (wanted.fov !== undefined) camera.chosenFov = fov;
}

function numbers(values: readonly number[], count: number): readonly number[] {
  if (values.length === count && values.every(Number.isFinite)) return values;
  throw new RangeError(`camera: found ${JSON.stringify(values)}, expected ${count} numbers`);
}

function axesOf(quaternion: readonly number[]): Pick<Pose, "right" | "down" | "forward"> {
  const length = Math.hypot(...quaternion);
  if (!(length > 0)) throw new RangeError("quaternion: found length 0, expected a rotation");
  const [w, x, y, z] = quaternion.map((value) => value / length);
  const right = unit([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]);
  const forward = unit([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]);
  return { right, down: cross(forward, right), forward };
}

export function quaternionOf({ right, down, forward }: Pose): [number, number, number, number] {
  // The largest of the four is found first, so that nothing is divided by a small one.
  const squares = [
    1 + right[0] + down[1] + forward[2],
    1 + right[0] - down[1] - forward[2],
    1 - right[0] + down[1] - forward[2],
    1 - right[0] - down[1] + forward[2],
  ];
  const [wx, wy, wz] = [down[2] - forward[1], forward[0] - right[2], right[1] - down[0]];
  const [xy, xz, yz] = [right[1] + down[0], right[2] + forward[0], down[2] + forward[1]];
  const largest = squares.indexOf(Math.max(...squares));
  const rows = [[squares[0], wx, wy, wz], [wx, squares[1], xy, xz], [wy, xy, squares[2], yz], [wz, xz, yz, squares[3]]];
  const found = rows[largest];
  const sign = found[0] < 0 ? -1 : 1;
  const length = Math.hypot(...found);
  return found.map((value) => (sign * value) / length) as [number, number, number, number];
}

/** Tells of a camera that has moved, now and then, and of where it came to rest. */
export class CameraChanges {
  private told: readonly [Pose, number] | null = null;
  private at = -NEWS_EVERY;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly tell: (state: ViewerCamera) => void) {}

  look(camera: Camera): void {
    if (this.told && camera.pose === this.told[0] && camera.fov === this.told[1]) return;
    clearTimeout(this.timer);
    const wait = this.at + NEWS_EVERY - performance.now();
    if (wait > 0) {
      this.timer = setTimeout(() => { this.look(camera); }, wait);
      return;
    }
    this.told = [camera.pose, camera.fov];
    this.at = performance.now();
    this.tell(cameraState(camera));
  }

  close(): void {
    clearTimeout(this.timer);
  }
}
