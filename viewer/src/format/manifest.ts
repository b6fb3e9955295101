/** The manifest: what people want to know about a file, as checked JSON. */

import { ViewerError } from "../base/errors";

export interface Manifest {
  readonly meta: Readonly<Record<string, string>>;
  /** Measured figures of each level, such as `psnr_full`, dB. */
  readonly quality: readonly Readonly<Record<string, number>>[];
}

/** The manifest in a chunk's raw bytes. */
export function parseManifest(raw: Uint8Array, levels: number): Manifest {
  let content: unknown;
  try {
    const text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(raw);
    content = JSON.parse(text);
    checkTexts(text);
  } catch (error) {
    throw bad(error instanceof Error ? error.message : "no JSON");
  }
  if (!isObject(content)) throw bad("no object");
  if (Object.keys(content).sort().join() !== "meta,quality") throw bad("other members");
  const { meta, quality } = content;
  if (!isObject(meta) || !Object.values(meta).every((v) => typeof v === "string")) {
    throw bad("meta is not names to text");
  }
  if (!Array.isArray(quality) || quality.length !== levels) throw bad("quality is not per level");
  for (const figures of quality as unknown[]) {
    if (!isObject(figures) || !Object.values(figures).every((v) => Number.isFinite(v))) {
      throw bad("quality is not names to finite numbers");
    }
  }
  return content as unknown as Manifest;
}

function bad(what: string): ViewerError {
  return new ViewerError("ValueRangeError", `manifest: ${what}`);
}

function isObject(value: unknown): value is Record<string, unknown> {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

/** Refuse a name that stands twice in an object of valid JSON, and half of a surrogate pair. */
function checkTexts(json: string): void {
  const open: (Set<string> | null)[] = [];
  const token = /"(?:[^"\\]|\\.)*"(\s*:)?|[{}[\]]/gs;
  for (const match of json.matchAll(token)) {
    const [found, colon] = match;
    if (found === "{") open.push(new Set());
    else if (found === "[") open.push(null);
    else if (found === "}" || found === "]") open.pop();
    else {
      const text = JSON.parse(colon ? found.slice(0, -colon.length) : found) as string;
      if (/\p{Surrogate}/u.test(text)) throw new Error("half of a surrogate pair");
      if (!colon) continue;
      const names = open[open.length - 1];
      if (names?.has(text)) throw new Error("a name stands twice");
      names?.add(text);
    }
  }
}
