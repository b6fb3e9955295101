/** Keys that move the camera while they are held. */

import type { Camera } from "./camera";

/** Pivot distances per second. */
const FLY = 0.7;
const KEY_TURN = 1.2;
const KEYS = new Set([
  "KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE",
  "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Equal", "Minus", "NumpadAdd", "NumpadSubtract",
]);

export class KeyMoves {
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

  /** True while a key is held. */
  get active(): boolean {
    return this.keys.size > 0;
  }

  /** Move by the keys held during `seconds`. */
  step(camera: Camera, seconds: number): void {
    const held = (...codes: string[]) => Number(codes.some((code) => this.keys.has(code)));
    const step = FLY * seconds * camera.pose.distance * (this.fast ? 4 : 1);
    camera.fly(
      step * (held("KeyD") - held("KeyA")),
      step * (held("KeyQ") - held("KeyE")),
      step * (held("KeyW") - held("KeyS")),
    );
    const turn = KEY_TURN * seconds;
    camera.orbit(
      turn * (held("ArrowRight") - held("ArrowLeft")),
      turn * (held("ArrowUp") - held("ArrowDown")),
    );
    camera.zoom(Math.exp(turn * (held("Minus", "NumpadSubtract") - held("Equal", "NumpadAdd"))));
  }

  /** Systems tell of no key that is let go while Meta is down. */
  private release({ code, key }: KeyboardEvent): void {
    if (key === "Meta") this.keys.clear();
    else this.keys.delete(code);
  }
}
