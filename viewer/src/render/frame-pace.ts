/** The time in which the device draws a frame, and what is left out where that is long. */

import type { AnyRenderer } from "./backend";

/** Milliseconds of a frame above which pictures are left out that another follows at once, and nothing fades. */
const SLOW = 100;
/** Frames' times for which another picture is waited for, at most. */
const PATIENCE = 4;

export class FramePace {
  /** Milliseconds of a frame; a guess at first, and never more than four times the last. */
  milliseconds = SLOW / 2;
  private measuring = false;

  /** True where a picture keeps the device from other work, and the way from one look to the next would be over in a few. */
  get isSlow(): boolean {
    return this.milliseconds > SLOW;
  }

  /** True where a picture would only keep the device from the next one; `since`: milliseconds since the last. */
  skips(since: number): boolean {
    return this.isSlow && since < PATIENCE * this.milliseconds;
  }

  /** A frame was given to the device. */
  measure(renderer: AnyRenderer): void {
    if (this.measuring) return;
    const begun = performance.now();
    this.measuring = true;
    renderer.finished().then(() => {
      this.milliseconds = Math.min(4 * this.milliseconds, performance.now() - begun);
      this.measuring = false;
    }, () => undefined);
  }
}
