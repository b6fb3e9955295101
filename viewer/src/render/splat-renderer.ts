/** A renderer of splats as the scene knows it, by whichever interface of the graphics device. */

import type { SplatLayer, Surface } from "./side";
import type { Side } from "../decode/messages";
import type { Pinhole } from "../camera/camera";

/** Camera and layers of a frame. */
export interface Frame {
  readonly camera: Pinhole;
  /** Seconds. */
  readonly time: number;
  /** Share of the width, from the left, that side 1 takes if it is there. */
  readonly divider: number;
  /** Left and lower edge of a picture that is one of several in a target that is clear; else it is all of the target. */
  readonly at?: readonly [number, number];
}

/** Uploads and pictures of one scene; `Renderer` says what each of these does. */
export interface SplatRenderer extends Surface {
  fade: number;
  /** The canvas that is drawn on. */
  readonly canvas: HTMLCanvasElement;
  /** Gives the device away, and asks for it again; the canvas of the scene hears of both as WebGL's do. */
  readonly loss: Pick<WEBGL_lose_context, "loseContext" | "restoreContext"> | null;
  readonly most: number;
  readonly waits: boolean;
  readonly bytes: number;
  reset(capacity: number): boolean;
  finished(): Promise<void>;
  close(): void;
  layer(side: Side): SplatLayer;
  give(now: number): void;
  drop(side: Side): void;
  setCenters(first: number, centers: Float32Array, done: () => void): void;
  draw(frame: Frame): void;
  capture(frame: Frame): Uint8ClampedArray | Promise<Uint8ClampedArray>;
}
