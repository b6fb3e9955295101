/** Everything in one module, which is the script of its workers too: for pages without a bundler, and for tests. */

import { ViewerElement, define, toolsModule, webgpuModule } from "../element/element";
import * as deferred from "./deferred";
import * as tools from "../element/tools";
import * as webgpu from "../render/webgpu/webgpu";
import { deferredModules, startWorker } from "./start-worker";
import type { WorkerScope } from "../decode/session";
import { inWorker } from "../decode/spawn-worker";

export { Assembler } from "../format/assembler";
export { unpackBlock } from "../format/block";
export { Residency, dropBlock } from "../fetch/residency";
export { catalogOf } from "../policy/catalog";
export { readAll } from "./read-all";
export { Decoder } from "../decode/anchor-decoder";
export { ListingDecoder } from "../decode/export-gaussians";
export { ViewerError, asViewerError } from "../base/errors";
export { PlainKernel } from "../decode/kernel/js";
export { LevelView } from "../decode/level-view";
export { parseBlockUtility } from "../format/notes/block-utility";
export { parsePoster } from "../format/notes/poster";
export { missing } from "../policy/state";
export { UnpackPool, serveUnpackPool } from "../fetch/unpack-pool";
export { estimateThroughput } from "../policy/throughput";
export { RowAllocator } from "../fetch/row-allocator";
export { coalesce } from "../policy/coalesce";
export { SimdKernel } from "../decode/kernel/wasm";
export { Sorter } from "../render/sorter";
export { parseCircle, poseOnCircle } from "../camera/viewpoints";
export { UploadQueue } from "../render/upload-queue";
export { HORIZON, lookahead, plainOrders, sortedOrders, viewedQuality } from "../policy/lookahead";
export { ViewPrediction } from "../policy/prediction";
export { coverage, extrapolate } from "../policy/visibility";
export { ViewerElement };
export type { ViewerEventMap, ViewerEvents } from "../element/element-events";
export type { ViewerLevel, ViewerStats } from "../ui/stats";
export type { ViewerCamera } from "../camera/camera-api";

for (const module of deferredModules) module.provide(deferred);
toolsModule.provide(tools);
webgpuModule.provide(webgpu);
if (inWorker()) startWorker(globalThis as unknown as WorkerScope);
else if (typeof document !== "undefined") define();
