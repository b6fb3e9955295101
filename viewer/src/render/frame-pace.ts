/** The time in which the device draws a frame, and what is left out where that is long. */

import type { AnyRenderer } from "./backend";

/** Milliseconds of a frame above which pictures are left out that another follows at once, and nothing fades. */
const SLOW = 100;
/** Milliseconds of one that splats have no part in, or that say nothing. */
const IDLE = 16;
/** Most times as long that a frame of more splats than the last is expected to take: few say little of many. */
const STEEPEST = 10;
/** Frames' times for which another picture is waited for, at most. */
const PATIENCE = 4;

export class FramePace {
  /** Milliseconds of the last frame that was measured, a guess at first, and its splats. */
  milliseconds = SLOW / 2;
  private splats = Infinity;
  private measuring = false;

  /** Milliseconds of a frame of so many splats. */
  private timeOf(splats: number): number {
    return IDLE + Math.max(0, this.milliseconds - IDLE) * Math.min(STEEPEST, Math.max(1, splats / this.splats));
  }

  /** True where a picture keeps the device from other work, and the way from one look to the next would be over in a few. */
  isSlow(splats: number): boolean {
    return this.timeOf(splats) > SLOW;
  }

  /** True where a picture would only keep the device from the next one; `since`: milliseconds since the last. */
  skips(since: number, splats: number): boolean {
    return this.isSlow(splats) && since < PATIENCE * this.timeOf(splats);
  }

  /** A frame of so many splats was given to the device. */
  measure(renderer: AnyRenderer, splats: number): void {
    if (this.measuring) return;
    const begun = performance.now();
    this.measuring = true;
    renderer.finished().then(() => {
      // A frame may have waited for other work: it is never taken for more than four times what was expected.
      this.milliseconds = Math.min(4 * this.timeOf(splats), performance.now() - begun);
      this.splats = splats;
      this.measuring = false;
    }, () => undefined);
  }
}
