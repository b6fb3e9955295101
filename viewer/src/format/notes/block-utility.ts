/** The manifest's note `gains`: how much each block takes off the error of rendered images. */

/** Numbers of the note to a decibel. */
const UTILITY_STEPS = 4;

/**
 * Reduction of the error of the images that show it, for each block of each level from 1 on, from the
 * manifest's note; null if it does not fit the file, whose levels have so many blocks.
 */
export function parseBlockUtility(text: string, blocks: readonly number[]): Float64Array[] | null {
  let bytes: string;
  try {
    bytes = atob(text);
  } catch {
    return null;
  }
  const count = blocks.reduce((sum, n) => sum + n, 0);
  if (!count || bytes.length !== count) return null;
  let at = 0;
  return blocks.map((n) => Float64Array.from({ length: n }, () => {
    const number = bytes.charCodeAt(at++);
    return number && 10 ** ((number - 255) / UTILITY_STEPS / 10);
  }));
}
