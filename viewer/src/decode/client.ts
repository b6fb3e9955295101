/** The decoder's worker, and the one that takes its place when the file has a newer version. */

import { ViewerError } from "../base/errors";
import type { ViewPose } from "../base/view-pose";
import type { FromDecoder, ToDecoder } from "./messages";
import { spawnWorker } from "./spawn-worker";

type Order = Extract<ToDecoder, { type: "open" }>;

export class DecoderClient {
  private worker = spawnWorker();
  /** Give up the worker that is to take the place. */
  private cancel: (() => void) | null = null;

  constructor(
    private readonly take: (message: FromDecoder) => void,
    private readonly stopped: (error: ViewerError) => void,
  ) {
    this.listen(this.worker);
  }

  tell(message: ToDecoder, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  /**
   * Decode another file beside the present one. What it gives is taken at once when all of it is
   * there, and nothing before; false if it could not be read, was cut, or was overtaken by a later one.
   */
  replace(order: Order, eye: ViewPose): Promise<boolean> {
    this.cancel?.();
    const worker = spawnWorker();
    const messages: FromDecoder[] = [];
    return new Promise((resolve) => {
      const cancel = () => {
        worker.terminate();
        if (this.cancel === cancel) this.cancel = null;
        resolve(false);
      };
      this.cancel = worker.onerror = cancel;
      worker.onmessage = ({ data }: MessageEvent<FromDecoder>) => {
        if (data.type === "error" || (data.type === "header" && data.facts.cut)) cancel();
        else {
          if (!["progress", "notice"].includes(data.type)) messages.push(data);
          if (data.type !== "complete") return;
          this.worker.terminate();
          this.worker = worker;
          this.cancel = null;
          this.listen(worker);
          for (const message of messages) this.take(message);
          resolve(true);
        }
      };
      for (const message of [{ ...order, whole: true }, { type: "view", eye, serial: 0, now: true }] as const) worker.postMessage(message);
    });
  }

  close(): void {
    this.worker.terminate();
    this.cancel?.();
  }

  private listen(worker: Worker): void {
    worker.onmessage = ({ data }: MessageEvent<FromDecoder>) => { this.take(data); };
    worker.onerror = (event) => { this.stopped(workerStopped(event)); };
  }
}

export function workerStopped(event: ErrorEvent): ViewerError {
  return new ViewerError("DeviceError", `The viewer's worker stopped: ${event.message || "it could not start, which a policy of the page may forbid (worker-src)"}.`);
}
