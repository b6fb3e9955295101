/** The decoder without a page: for Node, workers and other engines. The element is made of the same modules. */

import * as further from "./deferred";
import { laterDecoder } from "../base/lazy-module";

export { Assembler } from "../format/assembler";
export type { Tables } from "../format/assembler";
export { catalogOf, parseGains } from "../policy/catalog";
export { readAll } from "./read-all";
export { Decoder } from "../decode/anchor-decoder";
export { Decoding } from "../decode/session";
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
export type { Attributes, Eye, FromDecoder, SceneFacts, ToDecoder } from "../decode/messages";
export { PlainKernel } from "../decode/kernel/js";
export { SimdKernel, bestKernel } from "../decode/kernel/wasm";
export { Sorter } from "../render/sorter";
export { BlobSource, HttpSource } from "../fetch/source";
export type { ByteSource } from "../fetch/source";
export { startWorker } from "./start-worker";
export type { Scope } from "./start-worker";

laterDecoder.provide(further);
