/** All there is to import. The same file is the worker's script. */

export { Assembler } from "./assembler";
export { readAll } from "./check";
export { Decoder } from "./decoder";
export { ViewerError, asViewerError } from "./errors";
export { PlainKernel } from "./plain";
export { SimdKernel } from "./simd";
