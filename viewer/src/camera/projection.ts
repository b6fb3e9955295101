/** Cameras of OpenGL axes (y up, looking along -z), such as those of other engines and of headsets. */

import type { Pinhole } from "./camera";

/** The lens of a projection to clip space, 16 numbers, column after column; the picture has so many pixels. */
export function lensOf(projection: ArrayLike<number>, width: number, height: number): Omit<Pinhole, "w2c"> {
  return {
    width,
    height,
    fx: (projection[0] * width) / 2,
    fy: (projection[5] * height) / 2,
    cx: ((1 - projection[8]) * width) / 2,
    cy: ((1 + projection[9]) * height) / 2,
  };
}
