/** Tables on their way to the graphics device, some splats a frame: no frame waits for all that has come. */

import type { Side } from "./messages";
import { ROW } from "./shaders";

/** Splats whose tables change in one frame: 4 MiB of attributes. */
const FRAME = 64 * ROW;

/** Give splats from … to, counted from the first of what is given. */
export type Give = (from: number, to: number) => void;

export class Uploads {
  private todo: { readonly side: Side; readonly count: number; readonly give: Give; at: number }[] = [];
  private left = FRAME;

  get waits(): boolean {
    return this.todo.length > 0;
  }

  /** Give so many splats after what came before, or `soon`: before all of it. At once while the frame has room. */
  add(side: Side, count: number, give: Give, soon = false): void {
    const upload = { side, count, give, at: 0 };
    if (soon) this.todo.unshift(upload);
    else this.todo.push(upload);
    this.go();
  }

  /** Another frame has room. */
  frame(): void {
    this.left = FRAME;
    this.go();
  }

  /** Forget what is for a side. */
  drop(side: Side): void {
    this.todo = this.todo.filter((upload) => upload.side !== side);
  }

  private go(): void {
    while (this.waits && this.left > 0) {
      const upload = this.todo[0];
      const { count, at, give } = upload;
      // In whole rows, which pages divide.
      const to = Math.min(count, at + Math.ceil(this.left / ROW) * ROW);
      upload.at = to;
      this.left -= to - at;
      if (to === count) this.todo.shift();
      give(at, to);
    }
  }
}
