/** What draws a scene, by whichever interface of the graphics device; and what chooses it. */

import type { Vec } from "../base/vec3";
import type { SplatLayer, Surface } from "./side";
import type { Side, ToSorter } from "../decode/messages";
import type { Pinhole } from "../camera/camera";
import type { SceneEvents } from "./scene-options";
import type { Renderer } from "./renderer";

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
export interface DevicePainter extends Surface {
  fade: number;
  /** What is drawn on. */
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

/** One that halves larger pictures, and knows its splats, by itself. */
export interface OtherPainter extends DevicePainter {
  readonly api: "WebGPU";
  /** What headsets need is not there: this throws. */
  readonly gl: never;
  /** Draw a frame by a camera of so many times the pixels, of which those of the canvas are means. */
  drawFiner(frame: Frame, times: number, camera: Pinhole): void;
  /** Centre, deviations along `up` and across it, and opacity of each splat that hides something [n, 6]. */
  solids(up: Vec, opacityMin: number): Float32Array;
}

export type Painter = Renderer | OtherPainter;

/** The parts of a worker that a scene needs of the one that sorts. */
export interface SorterPort extends Pick<Worker, "onmessage" | "onerror" | "terminate"> {
  postMessage(message: ToSorter, transfer: Transferable[]): void;
}

/** In place of WebGL 2 and its sorter. */
export interface Backend {
  readonly sorter: SorterPort;
  /** `told` hears a sentence for people where it is not what was asked for. */
  makePainter(canvas: HTMLCanvasElement, told: Pick<SceneEvents, "notice">): Painter;
}
