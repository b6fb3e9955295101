/** Entry of the npm package, for apps with a bundler; its workers run `worker.ts`. */

import { ViewerElement, define, toolsModule, webgpuModule } from "../element/element";
import * as tools from "../element/tools";
import * as webgpu from "../render/webgpu/webgpu";

export { ViewerElement };
export type { Trouble } from "../base/errors";
export type { ViewerEventMap, ViewerEvents } from "../element/element-events";
export type { ViewerLevel, ViewerStats } from "../ui/stats";
export type { ViewerCamera } from "../camera/camera-api";

toolsModule.provide(tools);
webgpuModule.provide(webgpu);
if (typeof document !== "undefined") define();
