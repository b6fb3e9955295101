/** The served page's script: what the first picture needs; the rest comes after it. */

import { define, laterTools } from "../element/element";

laterTools.comesBy(() => import("../element/tools"));
define();
