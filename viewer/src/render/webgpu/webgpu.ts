/** WebGPU in place of WebGL 2, for who asked for it; what it goes on with where there is none, or none any more. */

import type { Backend, AnyRenderer } from "../backend";
import { Renderer } from "../renderer";
import type { SceneEvents } from "../scene-options";
import { GpuRenderer } from "./renderer";
import { DeviceSorter } from "./sorter";

const NONE = "WebGPU was asked for and is not there: WebGL 2 draws.";
const SHORT = "WebGPU has not enough graphics memory for the scene: WebGL 2 draws.";
const LOST = "WebGPU lost the graphics device for good: WebGL 2 draws.";
/** Losses of a device after which none is asked for again. */
const LOSSES = 2;

async function openDevice(): Promise<GPUDevice | null> {
  const gpu = (navigator as { gpu?: GPU }).gpu;
  const adapter = await gpu?.requestAdapter({ powerPreference: "high-performance" }) ?? null;
  if (!adapter) return null;
  const { maxBufferSize, maxStorageBufferBindingSize } = adapter.limits;
  return adapter.requestDevice({ requiredLimits: { maxBufferSize, maxStorageBufferBindingSize } });
}

/** WebGPU, or WebGL 2 with a sentence that says so. */
export async function openBackend(): Promise<Backend> {
  return new WebGpu(await openDevice().catch(() => null));
}

class WebGpu implements Backend {
  readonly sorter = new DeviceSorter();
  private told = "";
  private losses = 0;
  private resting = false;

  constructor(private device: GPUDevice | null) {
    if (!device) this.leave(NONE);
  }

  make(canvas: HTMLCanvasElement, told: Pick<SceneEvents, "notice">): AnyRenderer {
    const { device } = this;
    if (!device) {
      told.notice(this.told);
      return Renderer.create(canvas);
    }
    const tell = (name: string) => canvas.dispatchEvent(new Event(name, { cancelable: true }));
    const again = async (text = LOST) => {
      const next = this.losses < LOSSES ? await openDevice().catch(() => null) : null;
      // The scene was closed meanwhile.
      if (painter.closed) {
        next?.destroy();
        return;
      }
      this.device = next;
      if (!next) this.leave(text);
      painter.canvas.remove();
      tell("webglcontextrestored");
    };
    const loss = {
      loseContext: () => {
        this.resting = true;
        device.destroy();
      },
      restoreContext: () => {
        this.resting = false;
        void again();
      },
    };
    let short = false;
    const painter = new GpuRenderer(device, canvas, loss, () => {
      short = true;
      this.losses = LOSSES;
      device.destroy();
    });
    void device.lost.then(() => {
      if (painter.closed) return;
      tell("webglcontextlost");
      if (this.resting) return;
      this.losses++;
      void again(short ? SHORT : LOST);
    });
    return painter;
  }

  private leave(text: string): void {
    this.told = text;
    console.warn(`gsynopsis: ${text}`);
    this.sorter.leave();
  }
}
