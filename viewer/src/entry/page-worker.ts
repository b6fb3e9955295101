/** The served page's workers: what the first picture needs; the rest comes after it. */

import { laterDecoder } from "../base/lazy-module";
import { startWorker } from "./start-worker";
import type { Scope } from "./start-worker";

laterDecoder.comesBy(() => import("./deferred"));
startWorker(globalThis as unknown as Scope);
