/** What a worker does not need for the first picture. */

export { Lanes, loadDirectories } from "../fetch/block-scheduler";
export { addTable } from "../format/page-table";
export { PlainKernel } from "../decode/kernel/js";
export { help } from "../fetch/unpack-pool";
