/** Messages between the page and its workers. */

import type { PreloadedResponse } from "../fetch/preloaded-response";
import type { Trouble } from "../base/errors";
import type { ViewPose } from "../base/view-pose";
import type { Index } from "../format/file-index";
import type { TrainingFocals } from "../format/notes/training-focals";
import type { Manifest } from "../format/manifest";

/** Side 0 is the picture; side 1, if there is one, takes its left part. */
export type Side = 0 | 1;

export interface LevelFacts {
  readonly end: number;
  readonly anchors: number;
  readonly live: number;
}

export interface SceneFacts {
  readonly name: string;
  readonly levels: readonly LevelFacts[];
  readonly manifest: Manifest | null;
  readonly center: readonly [number, number, number];
  readonly radius: number;
  readonly extent: number;
  /** Finest level that this device shows. */
  readonly most: number;
  /** Splats that are held at most, all levels together. */
  readonly room: number;
  /** The file ends within a level. */
  readonly cut: boolean;
}

/** Attributes of slots first … first + drawn.length, see `packSlot`, and which are drawn at all. */
export interface Attributes {
  readonly first: number;
  readonly words: Uint32Array;
  readonly drawn: Uint8Array;
}

export interface Progress {
  readonly bytes: number;
  readonly total: number;
  /** Bits per second over the last seconds. */
  readonly rate: number;
}

export type ToDecoder =
  | {
      readonly type: "open";
      readonly source: string | Blob;
      readonly name: string;
      readonly budget: number;
      readonly plain: boolean;
      /** Cores of the machine; large scenes are unpacked in several workers if it has more than two. */
      readonly cores?: number;
      /** The answer to the first request, if the page has made it. */
      readonly preloaded?: PreloadedResponse | null;
      /** Show nothing before all of the base is there. */
      readonly whole?: boolean;
    }
  | { readonly type: "view"; readonly eye: ViewPose; readonly serial: number; readonly now: boolean }
  /** Side 1 is shown beside side 0 until its level is null. */
  | { readonly type: "level"; readonly side: Side; readonly cap: number | null; readonly serial: number }
  /** The device shows no finer level. */
  | { readonly type: "most"; readonly most: number }
  | { readonly type: "pause"; readonly paused: boolean }
  /** Attributes are sorted: those of levels between would be seen. */
  | { readonly type: "seen" }
  | { readonly type: "again" };

export type FromDecoder =
  | { readonly type: "header"; readonly facts: SceneFacts }
  | { readonly type: "manifest"; readonly manifest: Manifest }
  | { readonly type: "progress"; readonly progress: Progress }
  | { readonly type: "centers"; readonly first: number; readonly centers: Float32Array }
  | {
      readonly type: "attributes";
      readonly side: Side;
      /** Looks change by this, not by the view alone: they are to be mixed for a while. */
      readonly fade: boolean;
      readonly pieces: readonly Attributes[];
      /** Slots of the level shown; later ones are not drawn. */
      readonly limit: number;
      readonly focals: TrainingFocals | null;
      /** The last view or level that these follow. */
      readonly serial: number;
      readonly seconds: number;
    }
  | { readonly type: "level-ready"; readonly level: number; readonly bytes: number; readonly seconds: number }
  | { readonly type: "complete"; readonly bytes: number; readonly seconds: number }
  | { readonly type: "memory"; readonly tables: number; readonly decoded: number; readonly kernel: "wasm" | "plain"; readonly workers: number }
  | { readonly type: "notice"; readonly text: string }
  | { readonly type: "error"; readonly trouble: Trouble; readonly message: string };

/** Unpack blocks that come by `port`, see `UnpackPool`. */
export interface ToUnpackWorker {
  readonly type: "unpack";
  readonly port: MessagePort;
  readonly index: Index;
}

export type ToSorter =
  | { readonly type: "reset"; readonly capacity: number }
  | { readonly type: "centers"; readonly first: number; readonly centers: Float32Array }
  | {
      readonly type: "drawn";
      readonly side: Side;
      readonly first: number;
      readonly drawn: Uint8Array;
      readonly limit: number;
      /** Splats drawn before go on being drawn until `settle`. */
      readonly fade: boolean;
    }
  | { readonly type: "settle"; readonly side: Side }
  | { readonly type: "drop"; readonly side: Side }
  | { readonly type: "sort"; readonly side: Side; readonly epoch: number; readonly row: readonly number[]; readonly near: number; readonly serial: number; readonly spare: Uint32Array | null };

export interface Sorted {
  readonly type: "order";
  readonly side: Side;
  readonly epoch: number;
  readonly order: Uint32Array;
  readonly count: number;
  readonly serial: number;
}
