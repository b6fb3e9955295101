/** All there is to import. The same module is the script of its workers. */

import { ViewerElement, define, laterTools } from "./element";
import * as further from "./further";
import { laterDecoder } from "./later";
import * as tools from "./tools";
import { startWorker } from "./worker";
import type { Scope } from "./worker";
import { inWorker } from "./workers";

export { Assembler } from "./assembler";
export { unpackBlock } from "./block";
export { Bounded, drop, forget } from "./bounded";
export { catalogOf, parseGains } from "./catalog";
export { readAll } from "./check";
export { Decoder } from "./decoder";
export { ViewerError, asViewerError } from "./errors";
export { PlainKernel } from "./plain";
export { Look } from "./look";
export { parsePoster } from "./poster";
export { drawable, missing } from "./policy";
export { Pool, help } from "./pool";
export { estimate } from "./rate";
export { Room } from "./room";
export { runFrom } from "./runs";
export { SimdKernel } from "./simd";
export { Sorter } from "./sorter";
export { parseCircle, poseOnCircle } from "./viewpoints";
export { Uploads } from "./uploads";
export { ours, plainOrders, sortedOrders, viewedQuality } from "./viewed";
export { covered, extrapolated } from "./views";
export { ViewerElement };
export type { ViewerEventMap, ViewerEvents } from "./events";
export type { ViewerLevel, ViewerStats } from "./facts";
export type { ViewerCamera } from "./pose";

laterDecoder.provide(further);
laterTools.provide(tools);
if (inWorker()) startWorker(globalThis as unknown as Scope);
else if (typeof document !== "undefined") define();
