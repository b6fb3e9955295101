/** Options and events of a scene, between it and the element around it. */

import type { ViewerError } from "../base/errors";
import type { Progress, SceneFacts } from "../decode/messages";

export interface SceneOptions {
  readonly budget: number;
  readonly plain: boolean;
  /** Let looks change at once. */
  readonly still: boolean;
  /** Let the camera go where the scene may not hold. */
  readonly free: boolean;
  /** Fields of view are those of the longer side. */
  readonly byLonger: boolean;
  /** True if the wheel is this view's, not the page's. */
  readonly takesWheel: (event: WheelEvent) => boolean;
}

export interface SceneEvents {
  header(facts: SceneFacts): void;
  progress(progress: Progress): void;
  /** The decoded base is drawn. */
  base(seconds: number): void;
  /** The device has done that: nothing that is begun now delays it. */
  shown(): void;
  level(level: number, bytes: number, seconds: number): void;
  complete(bytes: number, seconds: number): void;
  notice(text: string): void;
  error(error: ViewerError): void;
  frame(): void;
}
