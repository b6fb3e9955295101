/** The renderers of a scene as it knows them, by WebGL 2 or another interface of the graphics device. */

import type { Vec } from "../base/vec3";
import type { ToSorter } from "../decode/messages";
import type { Pinhole } from "../camera/camera";
import type { SceneEvents } from "./scene-options";
import type { Renderer } from "./renderer";
import type { Frame, SplatRenderer } from "./splat-renderer";

export type { Frame };

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
