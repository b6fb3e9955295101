/** The worker's three roles: to load and decode a scene, to unpack blocks for one that does, or to sort splats. */

import { LazyModule } from "../base/lazy-module";
import { jsKernelModule } from "../decode/kernel/wasm";
import type { ToDecoder, ToUnpackWorker, ToSorter } from "../decode/messages";
import { DecodeSession } from "../decode/session";
import type { WorkerScope } from "../decode/session";
import { schedulerModule } from "../fetch/base-loader";
import type * as unpackPool from "../fetch/unpack-pool";
import { pageTableModule } from "../format/assembler";
import { Sorter } from "../render/sorter";

const poolModule = new LazyModule<typeof unpackPool>();
/** The modules of `deferred.ts`, each to be provided where it is needed. */
export const deferredModules = [jsKernelModule, schedulerModule, poolModule, pageTableModule] as const;

/** Take the role that the first message names. */
export function startWorker(scope: WorkerScope): void {
  let decoding: DecodeSession | null = null;
  const sorter = new Sorter();
  scope.onmessage = (event: MessageEvent<ToDecoder | ToSorter | ToUnpackWorker>) => {
    const message = event.data;
    switch (message.type) {
      case "open":
        decoding = new DecodeSession(scope, message);
        break;
      case "unpack":
        poolModule.get().then(({ serveUnpackPool }) => { serveUnpackPool(message.port, message.index); }, reportError);
        break;
      case "reset":
        sorter.reset(message.capacity);
        break;
      case "centers":
        sorter.setCenters(message.first, message.centers);
        break;
      case "drawn":
        sorter.setDrawn(message.side, message.first, message.drawn, message.limit, message.fade);
        break;
      case "settle":
        sorter.settle(message.side);
        break;
      case "drop":
        sorter.drop(message.side);
        break;
      case "sort": {
        const { side, epoch, serial } = message;
        const order = message.spare ?? new Uint32Array(0);
        const count = sorter.sort(side, message.row, message.near, order);
        scope.postMessage({ type: "order", side, epoch, order, count, serial }, [order.buffer]);
        break;
      }
      default:
        decoding?.take(message);
    }
  };
}
