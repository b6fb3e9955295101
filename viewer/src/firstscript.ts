/** The served page's workers: what the first picture needs; the rest comes after it. */

import { later } from "./later";
import { startWorker } from "./worker";
import type { Scope } from "./worker";

later.decoder.comesBy(() => import("./further"));
startWorker(globalThis as unknown as Scope);
