/** Mouse and touch to camera. */

import type { Camera } from "./camera";

/** Radians per canvas height. */
const TURN = 3;
const WHEEL = 0.0015;
/** The same for the pinch of a trackpad, which comes as small turns of the wheel with Ctrl. */
const PINCH = 0.01;
const PINCH_MAX = 50;

export class Controls {
  private readonly pointers = new Map<number, { x: number; y: number }>();

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
      const pinches = event.ctrlKey && Math.abs(event.deltaY) < PINCH_MAX;
      camera.zoom(Math.exp((pinches ? PINCH : WHEEL) * lines * event.deltaY));
      changed();
    }, { passive: false, signal });
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
