/** The workers' script where it stands beside the element's. */

import { startWorker } from "./worker";
import type { Scope } from "./worker";

startWorker(globalThis as unknown as Scope);
