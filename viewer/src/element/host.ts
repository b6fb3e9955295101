/** The element, as the code that comes later knows it. */

import type { ViewerError } from "../base/errors";
import type { Progress } from "../decode/messages";
import type { Member } from "./crowd";
import type { SceneView } from "../render/scene-view";
import type { ViewerEvents } from "./element-events";

export interface Host {
  readonly element: Member;
  /** Elements of the page that have a graphics device. */
  readonly drawing: Set<Member>;
  /** Bytes up to the end of each level that is decoded. */
  readonly done: readonly number[];
  scene(): SceneView | null;
  progress(): Progress;
  /** The file could not be shown. */
  trouble(): boolean;
  /** Show another file in place of what is there. */
  show(source: string | Blob, name: string): void;
  /** Go on to another version of the file. */
  reopen(source: string | Blob, name: string): void;
  /** `fresh`: what went wrong before does not matter any more. */
  say(text: string, fresh?: boolean): void;
  resize(): void;
  fail(error: ViewerError): void;
  /** Show an error; `kept`: the scene before is still there. */
  tell(error: ViewerError, kept?: boolean): void;
  emit<Name extends keyof ViewerEvents>(name: Name, detail: ViewerEvents[Name]): void;
}
