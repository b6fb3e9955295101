/** The workers' script where it stands beside the element's. */

import * as further from "./deferred";
import { laterDecoder } from "../base/lazy-module";
import { startWorker } from "./start-worker";
import type { Scope } from "./start-worker";

laterDecoder.provide(further);
startWorker(globalThis as unknown as Scope);
