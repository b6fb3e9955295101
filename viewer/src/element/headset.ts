/** The scene in a headset (WebXR `immersive-vr`): its frames in place of the canvas's, a picture for each eye. */

import { add, cross, unit } from "../base/vec3";
import type { Vec } from "../base/vec3";
import { w2cOf } from "../camera/camera";
import type { Camera, Pose } from "../camera/camera";
import { lensOf } from "../camera/projection";
import type { SceneView } from "../render/scene-view";
import type { Host } from "./host";
import type { Places } from "./places";
import { Walk } from "./walk";

/** Splats of the finest level that is shown, at most: each is drawn twice a frame. */
const SPLATS = 300_000;
/** Height of a person's eyes, metres; where there is no ground, what is looked at is twice as far away. */
const EYES = 1.6;
const AWAY = 2;
/** Field of view for which is decoded, radians: as wide as headsets are. */
const WIDE = 2;
/** Metres a second with the stick where there is no ground, and the least of its way that counts. */
const PACE = 1.5;
const DEAD = 0.2;

/** A page has one at most. */
let worn: XRSession | null = null;

/** Show a button where there may be a headset. */
export function offerHeadset(button: HTMLElement): void {
  button.hidden = true;
  navigator.xr?.isSessionSupported("immersive-vr").then((there) => { button.hidden = !there; }, () => undefined);
}

/** Show the scene in the headset, or leave it; to be called at a key or a click. */
export async function toggleHeadset(host: Host, places: Places): Promise<void> {
  const scene = host.scene();
  if (worn) await worn.end();
  else if (scene?.facts) {
    const session = await navigator.xr!.requestSession("immersive-vr");
    worn = session;
    session.addEventListener("end", () => { worn = null; });
    try {
      const { gl } = scene.renderer;
      await gl.makeXRCompatible();
      const baseLayer = new XRWebGLLayer(session, gl, { antialias: false, depth: false, alpha: false });
      await session.updateRenderState({ baseLayer });
      show(session, baseLayer, await session.requestReferenceSpace("local"), scene, host, places);
    } catch (error) {
      await session.end().catch(() => undefined);
      throw error;
    }
  }
}

function show(session: XRSession, layer: XRWebGLLayer, space: XRReferenceSpace, scene: SceneView, host: Host, places: Places): void {
  const { camera } = scene;
  const tall = places.tall(scene);
  const walk = tall ? new Walk(() => places.survey(scene), tall) : null;
  const metre = tall ? tall / EYES : camera.pose.distance / AWAY;
  const poseOf = posesOf(camera, metre);
  /** Origin of the headset's own space. */
  let origin = camera.pose.position;
  let eyes: readonly XRView[] = [];
  let last = 0;

  const { gl } = scene.renderer;
  scene.painter = (frame) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    for (const eye of eyes) {
      const { x, y, width, height } = layer.getViewport(eye)!;
      scene.renderer.draw({ ...frame, at: [x, y], camera: { ...lensOf(eye.projectionMatrix, width, height), w2c: w2cOf(poseOf(eye.transform, origin)) } });
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  };
  const draw = (now: number, frame: XRFrame) => {
    if (host.scene() !== scene) {
      session.end().catch(() => undefined);
      return;
    }
    session.requestAnimationFrame(draw);
    const head = frame.getViewerPose(space);
    if (!head) return;
    camera.pose = poseOf(head.transform, origin);
    const { position } = camera.pose;
    const [aside, ahead] = stickOf(session);
    const seconds = Math.min(100, now - last) / 1000;
    last = now;
    if (walk && (aside || ahead)) walk.step(camera, seconds, ahead, aside, false);
    else camera.fly(PACE * metre * seconds * aside, 0, PACE * metre * seconds * ahead);
    origin = add(origin, add(camera.pose.position, position, -1));
    eyes = head.views;
    scene.move();
    scene.frame(now);
    eyes = [];
  };
  const restore = lighten(scene, Math.min(SPLATS, Number(host.element.getAttribute("budget")) || SPLATS));
  session.addEventListener("end", () => {
    scene.painter = null;
    restore();
    host.resize();
  });
  session.requestAnimationFrame(draw);
}

/** Show one level alone, of no more splats than these, in all directions that eyes see; gives what undoes it. */
function lighten(scene: SceneView, most: number): () => void {
  const { camera, caps: [level, other] } = scene;
  const { pose, chosenFov } = camera;
  scene.setLevel(Math.min(level, Math.max(0, scene.facts!.levels.filter(({ live }) => live <= most).length - 1)));
  scene.compare(null);
  camera.chosenFov = WIDE;
  return () => {
    Object.assign(camera, { pose, chosenFov });
    scene.setLevel(level);
    scene.compare(other);
  };
}

/** Poses in the world of what is in the headset's own space: that is level, and ahead is where the camera looks now. */
function posesOf({ pose: { right: aside, distance }, up }: Camera, metre: number): (transform: XRRigidTransform, origin: Vec) => Pose {
  const back = unit(cross(aside, up));
  const axes = [cross(up, back), up, back];
  return ({ matrix }, origin) => {
    const turn = (column: number, by: number, from: Vec) => axes.reduce((sum, axis, i) => add(sum, axis, by * matrix[4 * column + i]), from);
    const [right, down, forward] = [1, -1, -1].map((by, column) => turn(column, by, [0, 0, 0]));
    return { position: turn(3, metre, origin), right, down, forward, distance };
  };
}

/** Way of the sticks that are pushed: to the right, ahead. */
function stickOf({ inputSources }: XRSession): [number, number] {
  for (const { gamepad } of inputSources) {
    const [, , x = 0, y = 0] = gamepad?.axes ?? [];
    if (Math.hypot(x, y) > DEAD) return [x, -y];
  }
  return [0, 0];
}
