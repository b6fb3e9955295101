/** A camera's way to another place, in half a second. */

import { add } from "../base/vec3";
import type { Vec } from "../base/vec3";
import type { Camera } from "./camera";
import { cameraState, placeCamera } from "./camera-api";
import type { ViewerCamera } from "./camera-api";

const MILLISECONDS = 500;

export class Glide {
  private readonly start = performance.now();
  private readonly from: ViewerCamera;
  private done = false;

  /** `still`: be there at once. */
  constructor(camera: Camera, private readonly to: Pick<ViewerCamera, "position" | "target" | "quaternion">, private readonly still: boolean) {
    this.from = cameraState(camera);
  }

  get active(): boolean {
    return !this.done;
  }

  step(camera: Camera): void {
    const { from, to } = this;
    const passed = this.still ? 1 : Math.min(1, (performance.now() - this.start) / MILLISECONDS);
    this.done = passed === 1;
    const share = passed * passed * (3 - 2 * passed);
    // The shorter of both ways around.
    const sign = from.quaternion.reduce((sum, value, i) => sum + value * to.quaternion[i], 0) < 0 ? -1 : 1;
    const mixed = (a: readonly number[], b: readonly number[], scale = 1) => a.map((value, i) => value + share * (scale * b[i] - value));
    const [position, target] = [mixed(from.position, to.position) as Vec, mixed(from.target, to.target) as Vec];
    if (!add(target, position, -1).some(Boolean)) return;
    placeCamera(camera, { position, target, quaternion: mixed(from.quaternion, to.quaternion, sign) as [number, number, number, number] });
  }
}
