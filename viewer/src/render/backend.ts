/** The renderers of a scene as it knows them, by WebGL 2 or another interface of the graphics device. */

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

/** One that halves larger pictures, and knows its splats, by itself. */
export interface OtherRenderer extends SplatRenderer {
  readonly api: "WebGPU";
  /** Throws: only headsets ask for it, which are not drawn so. */
  readonly gl: never;
  /** Draw a frame by a camera of so many times the pixels, of which those of the canvas are means. */
  drawFiner(frame: Frame, times: number, camera: Pinhole): void;
  /** Centre, deviations along `up` and across it, and opacity of each splat that hides something [n, 6]. */
  solids(up: Vec, opacityMin: number): Float32Array;
}

export type AnyRenderer = Renderer | OtherRenderer;

/** The parts of a worker that a scene needs of the one that sorts. */
export interface SorterPort extends Pick<Worker, "onmessage" | "onerror" | "terminate"> {
  postMessage(message: ToSorter, transfer: Transferable[]): void;
}

/** In place of WebGL 2 and its sorter. */
export interface Backend {
  readonly sorter: SorterPort;
  /** `told` hears a sentence for people where it is not what was asked for. */
  make(canvas: HTMLCanvasElement, told: Pick<SceneEvents, "notice">): AnyRenderer;
}
