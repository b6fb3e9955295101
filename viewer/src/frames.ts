/** Frames a second as people count them. */

/** Frames older than this do not count, ms. */
const WINDOW = 1000;
/** Fewer frames than fill this say little of the pace, ms: two of them may be a hair apart. */
const SPAN = 250;

/** Counts the frames of the last second; the mean of 1/dt would say thousands after two close frames. */
export class FrameRate {
  private times: number[] = [];

  /** A frame at this time, ms; times ascend. */
  add(now: number): void {
    this.times = [...this.times.filter((time) => now - time < WINDOW), now];
  }

  /** Frames a second at the last frame; 0 before the second one, and after a pause of a second. */
  get perSecond(): number {
    const { times } = this;
    const span = (times.at(-1) ?? 0) - (times[0] ?? 0);
    return (1000 * Math.max(0, times.length - 1)) / Math.max(span, SPAN);
  }
}
