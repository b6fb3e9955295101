/** The sorter of a scene whose device sorts by itself: it says at once that it is done; after that device, a worker. */

import type { Side, ToSorter } from "../../decode/messages";
import { spawnWorker } from "../../decode/spawn-worker";
import type { SorterPort } from "../backend";

export class DeviceSorter implements SorterPort {
  onmessage: Worker["onmessage"] = null;
  onerror: Worker["onerror"] = null;
  private worker: Worker | null = null;
  private capacity = 0;
  /** Marks of each side: 1 for a splat of its level that is drawn. */
  private marks: [Uint8Array | null, Uint8Array | null] = [null, null];
  private limits: [number, number] = [0, 0];

  /** Sort by a worker from now on, to which all is told again. */
  leave(): void {
    const worker = (this.worker ??= spawnWorker());
    worker.onmessage = (event) => { this.onmessage?.call(worker, event); };
    worker.onerror = (event) => { (this.onerror as ((event: ErrorEvent) => void) | null)?.(event); };
    this.marks = [null, null];
  }

  postMessage(message: ToSorter, transfer: Transferable[]): void {
    if (this.worker) this.worker.postMessage(message, transfer);
    else this.take(message);
  }

  terminate(): void {
    this.worker?.terminate();
  }

  private take(message: ToSorter): void {
    switch (message.type) {
      case "reset":
        this.capacity = message.capacity;
        this.marks = [null, null];
        break;
      case "drawn": {
        const { side, first, drawn, limit } = message;
        const marks = (this.marks[side] ??= new Uint8Array(this.capacity));
        marks.set(drawn.subarray(0, Math.max(0, marks.length - first)), first);
        this.limits[side] = limit;
        break;
      }
      case "drop":
        this.marks[message.side] = null;
        break;
      case "sort": {
        const { side, epoch, serial, spare } = message;
        const data = { type: "order", side, epoch, serial, order: spare, count: this.count(side) };
        queueMicrotask(() => { this.onmessage?.call(this as unknown as Worker, new MessageEvent("message", { data })); });
        break;
      }
    }
  }

  private count(side: Side): number {
    const marks = this.marks[side];
    return marks ? marks.subarray(0, this.limits[side]).reduce((sum, mark) => sum + mark, 0) : 0;
  }
}
