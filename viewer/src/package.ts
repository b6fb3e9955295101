/** What the package gives to apps with a bundler; its workers run `script.ts`. */

import { ViewerElement, define, laterTools } from "./element";
import * as tools from "./tools";

export { ViewerElement };
export type { Trouble } from "./errors";
export type { ViewerEventMap, ViewerEvents } from "./events";
export type { ViewerLevel, ViewerStats } from "./facts";
export type { ViewerCamera } from "./pose";

laterTools.provide(tools);
if (typeof document !== "undefined") define();
