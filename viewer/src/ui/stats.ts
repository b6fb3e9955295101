/** Figures of the scene on screen, for people and for scripts. */

import type { Progress, SceneFacts } from "../decode/messages";
import type { SceneView } from "../render/scene-view";

const MIB = 2 ** 20;

export interface ViewerLevel {
  /** Bytes of the file up to the end of the level. */
  readonly bytes: number;
  readonly anchors: number;
  /** Decoded and ready to be shown. */
  readonly ready: boolean;
  /** PSNR on held-out photos, dB, if the file says it. */
  readonly psnr: number | null;
  /** Width and height of these photos, as `480 x 320`, if the file says it. */
  readonly pictures: string | null;
}

export interface ViewerStats {
  /** Bytes read, and bytes of the file, 0 before it is known. */
  readonly bytes: number;
  readonly total: number;
  /** Bits per second over the last seconds. */
  readonly rate: number;
  /** Splats drawn. */
  readonly splats: number;
  /** Frames in the last second; a scene at rest is not drawn anew. */
  readonly fps: number;
  /** Seconds of the last decoding. */
  readonly decodeSeconds: number;
}

/** The levels of a file; `done` are those decoded, by number. */
export function levelsOf(facts: SceneFacts, done: readonly number[]): ViewerLevel[] {
  const quality = facts.manifest?.quality ?? [];
  const size = facts.manifest?.meta.pictures ?? "";
  const pictures = /^\d{1,6} x \d{1,6}$/.test(size) ? size : null;
  return facts.levels.map(({ end, anchors }, k) => {
    const psnr = (quality.at(k) ?? {}).psnr_full;
    return { bytes: end, anchors, ready: k in done, psnr: typeof psnr === "number" ? psnr : null, pictures };
  });
}

/** Counts frames. */
export class FrameCounter {
  /** Times of the frames of the last second, milliseconds. */
  private times: number[] = [];

  add(): void {
    this.times.splice(0, this.times.length - this.perSecond);
    this.times.push(performance.now());
  }

  get perSecond(): number {
    const since = performance.now() - 1000;
    return this.times.filter((at) => at > since).length;
  }
}

export function statsOf(scene: SceneView | null, { bytes, total, rate }: Progress, frames: FrameCounter): ViewerStats {
  const { perSecond: fps } = frames;
  // A small file is there whole before anything of it was understood.
  const end = total || (scene?.facts?.levels.at(-1)?.end ?? 0);
  return { bytes, total: end, rate, splats: scene?.drawn ?? 0, fps, decodeSeconds: scene?.decodeSeconds ?? 0 };
}

export function statsText(levels: readonly ViewerLevel[], stats: ViewerStats): string {
  const lines = levels.map(({ bytes, ready, psnr }, k) => {
    const figure = psnr === null ? "" : `  ${psnr.toFixed(2)} dB`;
    return `${ready ? "✓" : " "} L${k}  ${(bytes / MIB).toFixed(2)} MiB${figure}`;
  });
  const first = levels.at(0);
  if (first?.pictures && first.psnr !== null) lines.push(`dB: photos of ${first.pictures}`);
  lines.push(
    `${(stats.bytes / MIB).toFixed(2)} MiB  ${(stats.rate / 1e6).toFixed(1)} Mbit/s`,
    `${stats.splats.toLocaleString("en")} splats  ${stats.fps} fps`,
    `decoded in ${(1000 * stats.decodeSeconds).toFixed(0)} ms`,
  );
  return lines.join("\n");
}
