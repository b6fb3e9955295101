/** The served page's script: what the first picture needs; the rest comes after it. */

import { define } from "./element";
import { later } from "./later";

later.tools.comesBy(() => import("./tools"));
define();
