/** The part of a worker's code that the first image does not need. */

export * from "../decode/kernel/js";
export * from "../fetch/block-scheduler";
export * from "../fetch/unpack-pool";
export * from "../format/page-table";
