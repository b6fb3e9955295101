/** What a worker does not need for the first picture. */

export { Lanes, loadDirectories } from "./lanes";
export { addTable } from "./pages";
export { PlainKernel } from "./plain";
export { help } from "./pool";
