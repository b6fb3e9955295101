/** The low-pass filter of splats in an image of another size than the photos of training (Mip-Splatting). */

import type { TrainingFocals } from "../format/notes/training-focals";

/** px² that training adds to the diagonal of each projected covariance. */
const DILATION = 0.3;

/** px² on the diagonal of covariances: a Gaussian's own, and all; as render.base.dilations. */
export function lowPassFilter(focals: TrainingFocals | null, fx: number, fy: number): [number, number] {
  if (!focals) return [DILATION, DILATION];
  const here = Math.sqrt(fx * fy);
  const ratio = here / Math.min(Math.max(here, focals[0]), focals[1]);
  const own = DILATION * ratio * ratio;
  return [own, Math.max(own, DILATION)];
}
