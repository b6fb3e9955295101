/**
 * Pictures smaller than the photos of training, drawn larger and then halved (docs/methods.md §2.11).
 *
 * A device that is quick enough draws all frames so, another one those in which nothing moves.
 */

import type { Pinhole } from "../camera/camera";
import type { TrainingFocals } from "../format/notes/training-focals";
import type { Frame } from "./splat-renderer";
import type { Renderer } from "./renderer";
import type { SceneView } from "./scene-view";

/** Times larger, at most; a power of two. */
const TIMES_MAX = 4;
/** Pixels of the larger picture, at most. */
const PIXELS_MAX = 1 << 22;
/** Focal length in files whose Gaussians are antialiased, as render.base.ANTIALIASED: any size is right for them. */
const ANTIALIASED = 2 ** 40;
/** Milliseconds without a frame after which nothing moves. */
const REST = 120;
/** Milliseconds a frame, on average: below the first all frames are drawn larger, no more above the second. */
const QUICK = 20;
const SLOW = 30;
/** Frames in a row that are enough to tell. */
const ENOUGH = 20;

/** Factor by which an image is drawn larger, to be about as large as the photos of training: 1, 2 or 4. */
export function supersamplingFactor(focals: TrainingFocals | null, { width, height, fx, fy }: Pinhole): number {
  if (!focals || focals[0] >= ANTIALIASED) return 1;
  const wanted = (2 / 3) * (focals[0] / Math.sqrt(fx * fy));
  let times = 1;
  while (times < TIMES_MAX && times <= wanted && 4 * times * times * width * height <= PIXELS_MAX) times *= 2;
  return times;
}

/** The same for the level that a scene shows. */
function timesIn(scene: SceneView, camera: Pinhole): number {
  return scene.drawn ? supersamplingFactor(scene.renderer.layer(0).focals, camera) : 1;
}

/** The image on screen, RGBA8 [height, width, 4], as fine as it is at rest. */
export async function captureImage(scene: SceneView): Promise<{ width: number; height: number; pixels: Uint8ClampedArray }> {
  const frame = scene.frameOf();
  const { width, height } = frame.camera;
  const times = timesIn(scene, frame.camera);
  const pixels = await scene.renderer.capture({ ...frame, camera: enlargePinhole(frame.camera, times) });
  return { width, height, pixels: downsample(pixels, width, height, times) };
}

/** The same view in so many times the pixels. */
export function enlargePinhole(camera: Pinhole, times: number): Pinhole {
  const { width, height, fx, fy, cx, cy, w2c } = camera;
  return { width: times * width, height: times * height, fx: times * fx, fy: times * fy, cx: times * cx, cy: times * cy, w2c };
}

/** RGBA8 [height, width, 4] of a picture `times` as large: means of squares of pixels. */
export function downsample(pixels: Uint8ClampedArray, width: number, height: number, times: number): Uint8ClampedArray {
  const out = new Uint8ClampedArray(4 * width * height);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < 4 * width; x++) {
      const column = 4 * times * (x >> 2) + (x & 3);
      let sum = 0;
      for (let down = 0; down < times; down++) {
        const row = (times * y + down) * 4 * times * width + column;
        for (let across = 0; across < times; across++) sum += pixels[row + 4 * across];
      }
      out[4 * width * y + x] = sum / (times * times);
    }
  }
  return out;
}

/** Targets in which larger images are drawn and halved, on one device. */
class Halving {
  private targets: { readonly frame: WebGLFramebuffer; readonly pixels: WebGLRenderbuffer }[] = [];
  private size = "";

  constructor(readonly renderer: Renderer) {}

  /** Draw a frame on the canvas; `camera`: the larger one. Blits are linear: half as large, each pixel is the mean of four. */
  drawFiner(frame: Frame, times: number, camera: Pinhole): void {
    const { gl } = this.renderer;
    const { width, height } = frame.camera;
    this.make(width, height, times);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets[0].frame);
    this.renderer.draw({ ...frame, camera });
    this.targets.forEach(({ frame: target }, number) => {
      const [large, small] = [times >> number, times >> (number + 1)];
      const next = this.targets.at(number + 1);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, target);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, next ? next.frame : null);
      gl.blitFramebuffer(0, 0, large * width, large * height, 0, 0, small * width, small * height, gl.COLOR_BUFFER_BIT, gl.LINEAR);
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  close(): void {
    const { gl } = this.renderer;
    for (const { frame, pixels } of this.targets) {
      gl.deleteFramebuffer(frame);
      gl.deleteRenderbuffer(pixels);
    }
    this.targets = [];
  }

  private make(width: number, height: number, times: number): void {
    const size = `${width} ${height} ${times}`;
    if (size === this.size) return;
    this.close();
    this.size = size;
    const { gl } = this.renderer;
    for (let each = times; each > 1; each /= 2) {
      const [frame, pixels] = [gl.createFramebuffer(), gl.createRenderbuffer()];
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.bindRenderbuffer(gl.RENDERBUFFER, pixels);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, each * width, each * height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, pixels);
      this.targets.push({ frame, pixels });
    }
  }
}

export class Supersampling {
  private halving: Halving | null = null;
  private view = "";
  last = 0;
  private timer = 0;
  /** Milliseconds a frame, and frames in a row. */
  private pace = 0;
  private row = 0;
  quick = false;
  tired = false;

  /** A frame was drawn: in its place a finer one, or word of one once nothing moves any more. */
  frame(scene: SceneView): void {
    const now = performance.now();
    const gap = now - this.last;
    this.last = now;
    clearTimeout(this.timer);
    const frame = scene.frameOf();
    const times = timesIn(scene, frame.camera);
    if (times === 1) return;
    const view = `${frame.divider} ${Object.values(frame.camera).join()}`;
    const changes = scene.renderer.waits || scene.panes.some((pane) => pane?.isFading(frame.time));
    const rests = gap >= REST && view === this.view && !changes;
    this.view = view;
    this.measure(gap);
    const { renderer } = scene;
    const finer = "drawFiner" in renderer ? renderer : this.on(renderer);
    if (rests || this.quick) finer.drawFiner(frame, times, enlargePinhole(frame.camera, times));
    if (!rests) this.timer = window.setTimeout(() => { scene.wake(); }, REST);
  }

  close(): void {
    clearTimeout(this.timer);
    this.halving?.close();
    this.halving = null;
  }

  private on(renderer: Renderer): Halving {
    if (this.halving?.renderer === renderer) return this.halving;
    this.halving?.close();
    return (this.halving = new Halving(renderer));
  }

  /** Measure frame times; a device that was too slow with larger frames draws none while moving any more. */
  private measure(gap: number): void {
    if (gap >= REST) {
      this.row = 0;
      return;
    }
    this.pace = this.row++ ? this.pace + (gap - this.pace) / Math.min(this.row, ENOUGH) : gap;
    if (this.row < ENOUGH) return;
    if (this.pace > SLOW && this.quick) this.tired = true;
    this.quick = !this.tired && this.pace < (this.quick ? SLOW : QUICK);
  }
}
