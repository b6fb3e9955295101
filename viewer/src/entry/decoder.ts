/** Entry of the npm package's `./decoder`: decoding without a page, for Node, workers and other engines. Some names are those of the first release. */

import * as deferred from "./deferred";
import { deferredModules } from "./start-worker";

export { Assembler } from "../format/assembler";
export type { Tables } from "../format/assembler";
export { parseBlockUtility as parseGains } from "../format/notes/block-utility";
export { catalogOf } from "../policy/catalog";
export { readAll } from "./read-all";
export { Decoder } from "../decode/anchor-decoder";
export { DecodeSession as Decoding } from "../decode/session";
export { SHARED } from "../format/directory";
export type { BlockRecord } from "../format/directory";
export { ViewerError, asViewerError } from "../base/errors";
export type { Trouble } from "../base/errors";
export { checkLength, hasSplats, indexLength, parseIndex } from "../format/file-index";
export type { ChunkEntry, Header, Index, LevelEntry } from "../format/file-index";
export { gaussiansOf } from "../decode/export-gaussians";
export type { Gaussians } from "../decode/export-gaussians";
export type { Kernel } from "../decode/kernel/kernel";
export { Loader } from "../fetch/base-loader";
export type { LoaderEvents } from "../fetch/base-loader";
export type { Manifest } from "../format/manifest";
export type { ViewPose as Eye } from "../base/view-pose";
export type { Attributes, FromDecoder, SceneFacts, ToDecoder } from "../decode/messages";
export { PlainKernel } from "../decode/kernel/js";
export { SimdKernel, bestKernel } from "../decode/kernel/wasm";
export { Sorter } from "../render/sorter";
export { BlobSource, HttpSource } from "../fetch/source";
export type { ByteSource } from "../fetch/source";
export { startWorker } from "./start-worker";
export type { WorkerScope as Scope } from "../decode/session";

for (const module of deferredModules) module.provide(deferred);
