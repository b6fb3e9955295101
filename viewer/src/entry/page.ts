/** The served page's script: what the first picture needs; the rest comes after it. */

import { define, toolsModule, webgpuModule } from "../element/element";

toolsModule.loadBy(() => import("../element/tools"));
webgpuModule.loadBy(() => import("../render/webgpu/webgpu"));
define();
