/** Parts that come and go around the picture: the bar, which fades while nobody moves anything, and the first hint. */

import { appendElement } from "./shell";
import type { Toolbar } from "./toolbar";
import { translated } from "./words";

/** Milliseconds after which the bar fades. */
const IDLE = 3000;

export class Presence {
  /** The hint may be shown. */
  shown = true;
  private timer = 0;
  private hint: HTMLElement | null;

  constructor(private readonly parts: Toolbar) {
    const { room } = parts;
    this.hint = appendElement("div", "panel hint", room);
    this.hint.hidden = true;
    const fingers = matchMedia("(pointer: coarse)").matches;
    this.hint.textContent = translated(fingers ? "One finger turns, two move and zoom" : "Drag to turn, wheel to zoom, double click to look there");
    for (const name of ["pointermove", "pointerdown", "focusin"]) room.addEventListener(name, () => { this.wake(); });
    // A screen reader clicks without a pointer.
    for (const name of ["pointerdown", "click", "wheel"]) {
      room.addEventListener(name, () => { this.forget(); }, { passive: true });
    }
    this.wake();
  }

  /** Show the bar, for a while. */
  wake(): void {
    const { classList } = this.parts.room;
    classList.remove("idle");
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => { classList.add("idle"); }, IDLE);
  }

  /** A frame was drawn; `drawn`: something of the scene is in it. */
  frame(drawn: boolean): void {
    if (this.hint) this.hint.hidden = !this.shown || !drawn;
  }

  /** The first touch or key: the hint is not needed any more. */
  forget(): void {
    this.hint?.remove();
    this.hint = null;
  }
}
