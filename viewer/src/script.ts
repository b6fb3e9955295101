/** The workers' script where it stands beside the element's. */

import * as further from "./further";
import { laterDecoder } from "./later";
import { startWorker } from "./worker";
import type { Scope } from "./worker";

laterDecoder.provide(further);
startWorker(globalThis as unknown as Scope);
