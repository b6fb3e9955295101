/** What the package gives to apps with a bundler; its workers run `script.ts`. */

import { ViewerElement, define } from "./element";

export { ViewerElement };
export type { Trouble } from "./errors";
export type { ViewerEventMap, ViewerEvents } from "./events";
export type { ViewerLevel, ViewerStats } from "./facts";
export type { ViewerCamera } from "./pose";

if (typeof document !== "undefined") define();
