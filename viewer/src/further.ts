/** What a worker does not need for the first picture. */

export { Lanes } from "./lanes";
export { PlainKernel } from "./plain";
export { help } from "./pool";
