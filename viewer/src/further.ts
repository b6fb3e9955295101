/** What a worker does not need for the first picture. */

export { Foresight } from "./foresight";
export { PlainKernel } from "./plain";
export { help, poolFor } from "./pool";
