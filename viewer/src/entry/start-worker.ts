/** The worker's three roles: to load and decode a scene, to unpack blocks for one that does, or to sort splats. */

import { Decoding } from "../decode/session";
import { laterDecoder } from "../base/lazy-module";
import type { ToDecoder, ToHelper, ToSorter } from "../decode/messages";
import { Sorter } from "../render/sorter";

export interface Scope {
  onmessage: ((event: MessageEvent) => void) | null;
  postMessage(message: unknown, transfer?: Transferable[]): void;
}

/** Start as what the first message asks for. */
export function startWorker(scope: Scope): void {
  let decoding: Decoding | null = null;
  const sorter = new Sorter();
  scope.onmessage = (event: MessageEvent<ToDecoder | ToSorter | ToHelper>) => {
    const message = event.data;
    switch (message.type) {
      case "open":
        decoding = new Decoding(scope, message);
        break;
      case "help":
        laterDecoder.get().then(({ help }) => { help(message.port, message.index); }, reportError);
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
