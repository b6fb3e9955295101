/** The decoder without a page: for Node, workers and other engines. The element is made of the same modules. */

import * as further from "./further";
import { laterDecoder } from "./later";

export { Assembler } from "./assembler";
export type { Tables } from "./assembler";
export { catalogOf, parseGains } from "./catalog";
export { readAll } from "./check";
export { Decoder } from "./decoder";
export { Decoding } from "./decoding";
export { SHARED } from "./directory";
export type { BlockRecord } from "./directory";
export { ViewerError, asViewerError } from "./errors";
export type { Trouble } from "./errors";
export { checkLength, hasSplats, indexLength, parseIndex } from "./file";
export type { ChunkEntry, Header, Index, LevelEntry } from "./file";
export { gaussiansOf } from "./gaussians";
export type { Gaussians } from "./gaussians";
export type { Kernel } from "./kernel";
export { Loader } from "./loader";
export type { LoaderEvents } from "./loader";
export type { Manifest } from "./manifest";
export type { Attributes, Eye, FromDecoder, SceneFacts, ToDecoder } from "./messages";
export { PlainKernel } from "./plain";
export { SimdKernel, bestKernel } from "./simd";
export { Sorter } from "./sorter";
export { BlobSource, HttpSource } from "./source";
export type { ByteSource } from "./source";
export { startWorker } from "./worker";
export type { Scope } from "./worker";

laterDecoder.provide(further);
