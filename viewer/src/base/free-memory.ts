/** Memory given back at once where the browser can: one that rests collects no garbage for a long time. */

/** Give back the memory of an array that nobody reads any more. */
export function freeMemory({ buffer }: ArrayBufferView): void {
  (buffer as { transfer?: (bytes: number) => unknown }).transfer?.(0);
}
