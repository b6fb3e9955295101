/** The served page's workers: what the first picture needs; the rest comes after it. */

import { laterDecoder } from "./later";
import { startWorker } from "./worker";
import type { Scope } from "./worker";

laterDecoder.comesBy(() => import("./further"));
startWorker(globalThis as unknown as Scope);
