/** Tables on their way to the graphics device, some splats a frame: no frame waits for all that has come. */

import type { Side } from "../decode/messages";
import { ROW } from "./shaders";

/** Milliseconds of a frame on most screens, and how many of them the longest one counts for. */
const USUAL = 1000 / 60;
const LONGEST = 16;

/** Give splats from … to, counted from the first of what is given. */
export type UploadRange = (from: number, to: number) => void;

export class UploadQueue {
  private todo: { readonly side: Side; readonly count: number; readonly give: UploadRange; at: number }[] = [];
  private left: number;
  private last = 0;
  private waited = false;

  /** `room`: splats given in a frame. */
  constructor(private readonly room: number) {
    this.left = room;
  }

  get waits(): boolean {
    return this.todo.length > 0;
  }

  /** Give so many splats after what came before; at once while the frame has room. */
  add(side: Side, count: number, give: UploadRange): void {
    this.todo.push({ side, count, give, at: 0 });
    this.go();
  }

  /** Another frame, at a time in milliseconds, has room: more of it where frames take long anyway. */
  frame(now: number): void {
    const frames = this.waited ? (now - this.last) / USUAL : 1;
    this.left = this.room * Math.min(LONGEST, Math.max(1, frames));
    this.last = now;
    this.go();
    this.waited = this.waits;
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
