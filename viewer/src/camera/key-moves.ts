/** Keys that move the camera while they are held. */

import type { Camera } from "./camera";

/** Mover of a camera over the ground. */
export interface Walker {
  readonly unsettled: boolean;
  step(camera: Camera, seconds: number, ahead: number, aside: number, fast: boolean): void;
}

/** Pivot distances per second. */
const FLY = 0.7;
const KEY_TURN = 1.2;
const KEYS = new Set([
  "KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE",
  "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Equal", "Minus", "NumpadAdd", "NumpadSubtract",
]);

export class KeyMoves {
  /** The walk, while one is on foot. */
  walker: Walker | null = null;
  private readonly keys = new Set<string>();
  private fast = false;

  /** Hear of keys that are let go, until the signal. */
  listen(signal: AbortSignal): void {
    window.addEventListener("keyup", (event) => { this.release(event); }, { signal });
    window.addEventListener("keydown", (event) => { if (event.metaKey || event.ctrlKey || event.altKey) this.keys.clear(); }, { signal });
    window.addEventListener("blur", () => { this.keys.clear(); }, { signal });
  }

  /** Hold a key; false for one that does not move the camera. */
  press(event: KeyboardEvent): boolean {
    if (!KEYS.has(event.code)) return false;
    this.keys.add(event.code);
    this.fast = event.shiftKey;
    return true;
  }

  /** True while a key is held, or a walk is not where it should be. */
  get active(): boolean {
    return this.keys.size > 0 || (this.walker?.unsettled ?? false);
  }

  /** Move by the keys held during `seconds`. */
  step(camera: Camera, seconds: number): void {
    const held = (...codes: string[]) => Number(codes.some((code) => this.keys.has(code)));
    const { fast, walker } = this;
    const [aside, ahead] = [held("KeyD") - held("KeyA"), held("KeyW") - held("KeyS")];
    const step = FLY * seconds * camera.pose.distance * (fast ? 4 : 1);
    if (walker) walker.step(camera, seconds, ahead, aside, fast);
    else camera.fly(step * aside, step * (held("KeyQ") - held("KeyE")), step * ahead);
    const turn = KEY_TURN * seconds;
    const [yaw, pitch] = [turn * (held("ArrowRight") - held("ArrowLeft")), turn * (held("ArrowUp") - held("ArrowDown"))];
    if (walker) camera.look(-yaw, pitch);
    else camera.orbit(yaw, pitch);
    camera.zoom(Math.exp(turn * (held("Minus", "NumpadSubtract") - held("Equal", "NumpadAdd"))));
  }

  /** Systems tell of no key that is let go while Meta is down. */
  private release({ code, key }: KeyboardEvent): void {
    if (key === "Meta") this.keys.clear();
    else this.keys.delete(code);
  }
}
