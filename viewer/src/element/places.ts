/** The camera and what is solid: double clicks, the dense part in full, and how near it may come. */

import { add, dot, unit } from "../base/vec3";
import type { Vec } from "../base/vec3";
import { lookAt } from "../camera/camera";
import type { Camera, Pose } from "../camera/camera";
import { quaternionOf } from "../camera/camera-api";
import type { ViewerCamera } from "../camera/camera-api";
import { Glide } from "../camera/glide";
import { circleOf, firstView, limitsOf } from "../camera/viewpoints";
import type { SceneView } from "../render/scene-view";
import { Survey } from "../render/survey";
import { Walk } from "./walk";

/** Deviation of a ray at a depth of 1, as a share of the picture's height: for a click, and for the way ahead. */
const POINT = 0.004;
const AHEAD = 0.02;
/** Share of the light below which a place is behind something. */
const HIDDEN = 0.3;
/** Distance that the camera keeps from what is ahead, as a share of the scene's radius. */
const CLEARANCE = 0.02;

export class Places {
  /** The walk one is on. */
  walk: Walk | null = null;
  private found: Survey | null = null;
  private foundOf: readonly unknown[] = [];
  private guarded = "";

  constructor(private readonly scene: () => SceneView | null, private readonly levels: () => number) {}

  /** The solid splats of the scene as it is now. */
  survey(scene: SceneView): Survey {
    const { renderer } = scene;
    const now = [renderer, renderer.layer(0).limit, this.levels()];
    if (!this.found || now.some((each, i) => each !== this.foundOf[i])) {
      this.found = Survey.of(renderer, scene.camera.up);
      this.foundOf = now;
      this.guarded = "";
    }
    return this.found;
  }

  /** The point of the scene at a place of the picture, 0 … 1 from its left and upper edge; null where nothing is. */
  pick(x: number, y: number): Vec | null {
    const scene = this.scene();
    if (!scene?.facts) return null;
    const { width, height, fx, fy, cx, cy } = scene.pinhole();
    const { position, right, down, forward } = scene.camera.pose;
    const ray = unit(add(add(forward, right, (x * width - cx) / fx), down, (y * height - cy) / fy));
    const depth = this.survey(scene).depth(position, ray, (POINT * height) / fy);
    return depth === null ? null : add(position, ray, depth);
  }

  /** Look at the point at a place of the picture, and turn around it from then on; on foot, go where the ground is. */
  lookAt(x: number, y: number): void {
    const scene = this.scene();
    const point = this.pick(x, y);
    if (!scene || !point) return;
    const { camera } = scene;
    const { pose, up } = camera;
    const { tall } = this.walk ?? { tall: Infinity };
    if (dot(add(pose.position, point, -1), up) > tall / 2) this.glide({ ...pose, position: add(point, up, tall) });
    else this.glide(lookAt(pose.position, point, upOf(camera)));
  }

  /** Begin a walk as high above the ground as the first photo, or end it; false where there is no ground. */
  toggleWalk(): boolean {
    const scene = this.scene();
    if (!scene?.facts) return false;
    const { camera } = scene;
    const { walk } = this;
    this.walk = null;
    if (!walk) {
      const tall = this.tall(scene);
      if (tall) this.walk = new Walk(() => this.survey(scene), tall);
    }
    camera.onFoot = this.walk !== null;
    return this.walk !== null || walk !== null;
  }

  /** Height of the eyes above the ground: of the first photo, else as it is now; null where there is no ground. */
  tall(scene: SceneView): number | null {
    const { camera, facts } = scene;
    const poses = [facts && firstView(facts)?.pose, camera.pose].flatMap((pose) => pose ?? []);
    return poses.map(({ position }) => Walk.tall(this.survey(scene), position, camera.up)).find((depth) => depth !== null) ?? null;
  }

  /** True where a place of the scene is behind what hides it. */
  hides(at: Vec): boolean {
    const scene = this.scene();
    return scene !== null && this.survey(scene).clear(scene.camera.pose.position, at) < HIDDEN;
  }

  /** See all of what is dense from the present direction. */
  whole(): void {
    const scene = this.scene();
    if (!scene?.facts) return;
    const { camera, facts } = scene;
    const ball = this.survey(scene).dense() ?? { center: circleOf(facts).target, radius: facts.radius };
    const distance = ball.radius / Math.sin(camera.fov / 2);
    const { pose } = camera;
    camera.pose = { ...pose, position: add(ball.center, pose.forward, -distance), distance };
    camera.restrain();
    scene.mover = null;
    scene.move();
  }

  /** Go to a pose, in a glide where people do not ask for less motion. */
  glide(pose: Pose): void {
    const scene = this.scene();
    if (!scene?.facts) return;
    this.glideTo({ position: pose.position, target: add(pose.position, pose.forward, pose.distance), quaternion: quaternionOf(pose) });
  }

  glideTo(place: Pick<ViewerCamera, "position" | "target" | "quaternion">): void {
    const scene = this.scene();
    if (!scene?.facts) return;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    scene.mover = new Glide(scene.camera, place, still);
    scene.move();
  }

  /** Before a zoom: let it end before what is solid ahead, or before the middle of a haze. */
  guard(): void {
    const scene = this.scene();
    if (!scene?.facts || !scene.camera.limits) return;
    const { camera, facts } = scene;
    const { pose } = camera;
    // The line of sight and its end, wherever on it the camera is.
    const line = [...pose.forward, ...camera.pivot].map((value) => value.toFixed(4)).join();
    const survey = this.survey(scene);
    if (line === this.guarded) return;
    this.guarded = line;
    const limits = limitsOf(facts);
    const clear = survey.depth(pose.position, pose.forward, AHEAD * 2 * Math.tan(camera.fov / 2));
    const nearest = clear === null ? 0 : pose.distance - clear + CLEARANCE * facts.radius;
    camera.limits = { ...limits, near: Math.max(limits.near, nearest) };
  }
}

/** The scene's way up, or the camera's own where it looks along that. */
function upOf({ up, pose }: Camera): Vec {
  return Math.abs(dot(pose.forward, up)) > 0.99 ? [-pose.down[0], -pose.down[1], -pose.down[2]] : up;
}
