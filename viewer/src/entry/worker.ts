/** The workers' script where it stands beside the element's. */

import * as deferred from "./deferred";
import { deferredModules, startWorker } from "./start-worker";
import type { WorkerScope } from "../decode/session";

for (const module of deferredModules) module.provide(deferred);
startWorker(globalThis as unknown as WorkerScope);
