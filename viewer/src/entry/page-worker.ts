/** The served page's workers: what the first picture needs; the rest comes after it. */

import { deferredModules, startWorker } from "./start-worker";
import type { WorkerScope } from "../decode/session";

for (const module of deferredModules) module.loadBy(() => import("./deferred"));
startWorker(globalThis as unknown as WorkerScope);
