/** All there is to import. The same module is the script of its workers. */

import { ViewerElement, define, laterTools } from "../element/element";
import * as further from "./deferred";
import { laterDecoder } from "../base/lazy-module";
import * as tools from "../element/tools";
import { startWorker } from "./start-worker";
import type { Scope } from "./start-worker";
import { inWorker } from "../decode/spawn-worker";

export { Assembler } from "../format/assembler";
export { unpackBlock } from "../format/block";
export { Bounded, drop, forget } from "../fetch/residency";
export { catalogOf, parseGains } from "../policy/catalog";
export { readAll } from "./read-all";
export { Decoder } from "../decode/anchor-decoder";
export { ViewerError, asViewerError } from "../base/errors";
export { PlainKernel } from "../decode/kernel/js";
export { Look } from "../decode/level-view";
export { parsePoster } from "../ui/poster";
export { drawable, missing } from "../policy/state";
export { Pool, help } from "../fetch/unpack-pool";
export { estimate } from "../policy/throughput";
export { Room } from "../fetch/row-allocator";
export { runFrom } from "../policy/coalesce";
export { SimdKernel } from "../decode/kernel/wasm";
export { Sorter } from "../render/sorter";
export { parseCircle, poseOnCircle } from "../camera/viewpoints";
export { Uploads } from "../render/upload-queue";
export { ours, plainOrders, sortedOrders, viewedQuality } from "../policy/lookahead";
export { covered, extrapolated } from "../policy/visibility";
export { ViewerElement };
export type { ViewerEventMap, ViewerEvents } from "../element/element-events";
export type { ViewerLevel, ViewerStats } from "../ui/stats";
export type { ViewerCamera } from "../camera/camera-api";

laterDecoder.provide(further);
laterTools.provide(tools);
if (inWorker()) startWorker(globalThis as unknown as Scope);
else if (typeof document !== "undefined") define();
