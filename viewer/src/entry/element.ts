/** What the package gives to apps with a bundler; its workers run `script.ts`. */

import { ViewerElement, define, laterTools } from "../element/element";
import * as tools from "../element/tools";

export { ViewerElement };
export type { Trouble } from "../base/errors";
export type { ViewerEventMap, ViewerEvents } from "../element/element-events";
export type { ViewerLevel, ViewerStats } from "../ui/stats";
export type { ViewerCamera } from "../camera/camera-api";

laterTools.provide(tools);
if (typeof document !== "undefined") define();
