/** Mouse, touch and keyboard to camera. */

import type { Camera } from "./camera";

/** Radians per canvas height. */
const TURN = 3;
const WHEEL = 0.0015;
/** Pivot distances per second. */
const FLY = 0.7;
const KEY_TURN = 1.2;
const KEYS = new Set([
  "KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE",
  "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Equal", "Minus", "NumpadAdd", "NumpadSubtract",
]);

export class Controls {
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private readonly keys = new Set<string>();
  private fast = false;

  constructor(
    private readonly surface: HTMLElement,
    private readonly camera: Camera,
    private readonly changed: () => void,
    /** True if the wheel is this view's, not the page's. */
    takesWheel: (event: WheelEvent) => boolean,
    signal: AbortSignal,
  ) {
    surface.addEventListener("pointerdown", (event) => {
      // Synthetic pointers cannot be captured; they work all the same.
      try { surface.setPointerCapture(event.pointerId); } catch { /* not a real pointer */ }
      surface.focus({ preventScroll: true });
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    }, { signal });
    surface.addEventListener("pointermove", (event) => { this.move(event); }, { signal });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      surface.addEventListener(end, (event) => this.pointers.delete(event.pointerId), { signal });
    }
    surface.addEventListener("contextmenu", (event) => { event.preventDefault(); }, { signal });
    surface.addEventListener("wheel", (event) => {
      if (!takesWheel(event)) return;
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 20 : 1;
      camera.zoom(Math.exp(WHEEL * lines * event.deltaY));
      changed();
    }, { passive: false, signal });
    window.addEventListener("keyup", (event) => this.keys.delete(event.code), { signal });
    window.addEventListener("blur", () => { this.keys.clear(); }, { signal });
  }

  /** Hold a key that moves the camera; false for another one. */
  press(event: KeyboardEvent): boolean {
    if (!KEYS.has(event.code)) return false;
    this.keys.add(event.code);
    this.fast = event.shiftKey;
    this.changed();
    return true;
  }

  /** True while a key is held that moves the camera. */
  get active(): boolean {
    return this.keys.size > 0;
  }

  /** Move by the keys held during `seconds`. */
  step(seconds: number): void {
    const held = (...codes: string[]) => Number(codes.some((code) => this.keys.has(code)));
    const { camera } = this;
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

  private move(event: PointerEvent): void {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const size = this.surface.clientHeight || 1;
    const dx = (event.clientX - before.x) / size;
    const dy = (event.clientY - before.y) / size;
    const { camera } = this;
    if (this.pointers.size >= 2) this.pinch(event, dx / 2, dy / 2);
    else if (event.buttons & 2 || event.shiftKey) camera.pan(dx, dy);
    else if (event.buttons & 4 || event.ctrlKey) camera.look(TURN * dx, TURN * dy);
    else camera.orbit(TURN * dx, -TURN * dy);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.changed();
  }

  /** Two fingers: apart and together zooms, both the same way pans. */
  private pinch(event: PointerEvent, dx: number, dy: number): void {
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    const before = this.pointers.get(event.pointerId);
    if (!other || !before) return;
    const far = Math.hypot(before.x - other.x, before.y - other.y);
    const now = Math.hypot(event.clientX - other.x, event.clientY - other.y);
    if (far > 0 && now > 0) this.camera.zoom(far / now);
    this.camera.pan(dx, dy);
  }
}
