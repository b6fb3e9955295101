/** A walk: over what is beneath, at the height of a person's eyes, and not through what is solid. */

import { add, dot, rotate, unit } from "../base/vec3";
import type { Vec } from "../base/vec3";
import type { Camera } from "../camera/camera";
import type { Survey } from "../render/survey";

/** Heights of the eyes a second, and with Shift. */
const PACE = 1.5;
const QUICK = 3;
/** Lengths below are heights of the eyes: half of a body's width, the highest step, and how deep the ground may lie. */
const BODY = 0.2;
const STEP = 0.35;
const DEEP = 3;
/** Depths beneath the eyes at which a body must find room. */
const PARTS = [0, 0.3, 0.6];
/** Distance up to which is looked ahead; the splats of it are sought again when one has come half as far. */
const REACH = 4;
/** Least deviation of a splat on a ray at a depth of 1: ahead, where a body is wide, and to the ground. */
const SPREAD = 0.3;
const FOOT = 0.03;
/** Ways to both sides of what is ahead, radians. */
const ASIDE = 1;
/** Share of a height that is still to go after a second: e to the minus this. */
const SETTLE = 8;
const SETTLED = 0.005;

export class Walk {
  /** The eyes are not at their height yet. */
  unsettled = true;
  private near: { readonly of: Survey; readonly at: Vec; readonly survey: Survey } | null = null;

  /** `tall`: height of the eyes, world units. */
  constructor(private readonly survey: () => Survey, readonly tall: number) {}

  /** Height of the eyes where a photo was taken, above what is beneath it; null where nothing is. */
  static tall(survey: Survey, place: Vec, up: Vec): number | null {
    return survey.depth(place, [-up[0], -up[1], -up[2]], FOOT);
  }

  /** Go on for some seconds: ahead and to the right, -1 … 1. */
  step(camera: Camera, seconds: number, ahead: number, aside: number, fast: boolean): void {
    const { up, pose } = camera;
    const flat = (v: Vec) => unit(add(v, up, -dot(v, up)));
    const wish = add(add([0, 0, 0], flat(pose.forward), ahead), flat(pose.right), aside);
    const length = PACE * this.tall * seconds * (fast ? QUICK : 1);
    if (ahead || aside) move(camera, this.way(camera, unit(wish), length));
    const found = this.rise(camera.pose.position, up);
    const rise = found > STEP * this.tall ? 0 : found;
    this.unsettled = Math.abs(rise) > SETTLED * this.tall;
    if (this.unsettled) move(camera, add([0, 0, 0], up, rise * (1 - Math.exp(-SETTLE * seconds))));
  }

  /** The step towards a direction: shorter where something is near, and then to the side that has more room. */
  private way(camera: Camera, wish: Vec, length: number): Vec {
    const { up, pose: { position } } = camera;
    const free = (direction: Vec) => length * Math.min(1, Math.max(0, this.room(position, direction, up) / (BODY * this.tall) - 1));
    const ahead = free(wish);
    let step = add([0, 0, 0], wish, ahead);
    if (ahead < length) {
      const [left, right] = [ASIDE, -ASIDE].map((angle) => this.room(position, rotate(wish, up, angle), up));
      const lean = (left - right) / (left + right);
      const side = rotate(wish, up, Math.sign(lean) * (Math.PI / 2));
      step = add(step, side, Math.min(1, 3 * Math.abs(lean)) * free(side));
    }
    // Beside something high one may stand, and go away from it.
    const highest = Math.max(STEP * this.tall, this.rise(position, up));
    return this.rise(add(position, step), up) > highest ? [0, 0, 0] : step;
  }

  /** Distance to what is ahead of a body, as far as it is looked at. */
  private room(place: Vec, direction: Vec, up: Vec): number {
    const { tall } = this;
    const survey = this.around(place);
    return Math.min(...PARTS.map((part) => survey.depth(add(place, up, -part * tall), direction, SPREAD) ?? REACH * tall));
  }

  /** Way up to the height of the eyes above the ground; 0 where there is none, or it lies too deep. */
  private rise(place: Vec, up: Vec): number {
    const depth = Walk.tall(this.around(place), place, up);
    return depth !== null && depth < DEEP * this.tall ? this.tall - depth : 0;
  }

  /** The splats around a place. */
  private around(place: Vec): Survey {
    const reach = REACH * this.tall;
    const of = this.survey();
    const far = this.near?.of === of ? Math.hypot(...add(place, this.near.at, -1)) : Infinity;
    if (!this.near || far > reach / 2) this.near = { of, at: place, survey: of.around(place, 1.5 * reach) };
    return this.near.survey;
  }
}

/** Move a camera with its pivot, within its limits. */
function move(camera: Camera, by: Vec): void {
  const { right, down, forward } = camera.pose;
  camera.fly(dot(by, right), dot(by, down), dot(by, forward));
}
