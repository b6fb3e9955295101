/** The view that decoding and streaming are for. */

/** Pose and field of view: world to camera, rows of [R | t], OpenCV axes. */
export interface ViewPose {
  readonly w2c: readonly number[]; // [12]
  readonly position: readonly [number, number, number];
  /** Tangents of half the fields of view. */
  readonly right: number;
  readonly up: number;
}
