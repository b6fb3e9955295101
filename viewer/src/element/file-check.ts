/** A look at the first bytes of a file, before it takes the place of a scene; and words for what it is instead. */

import { ViewerError } from "../base/errors";
import { MAGIC } from "../format/layout.gen";

/** Bytes that tell what a file is. */
const HEAD = 16;
const SPLATS = /\.(ply|splat|ksplat|spz|sog|lcc|glb|gltf|usd[acz]?)$/i;
const SIGNS = /^(ply|glTF|PK)/;
const ANY = "`gsynopsis import FILE` makes one of PLY, SPZ, SOG and other splats.";

/** A scene to show: the file itself, or, after `begin`, what our own server makes of splats; rejects with why there is none. */
export async function sceneOf(source: string | Blob, name: string, begin: (() => AbortSignal) | null): Promise<string | Blob> {
  const head = await headOf(source);
  if (!head.length) throw new ViewerError("TruncatedError", `${name} is incomplete: it has 0 bytes.`);
  if (MAGIC.every((byte, i) => i >= head.length || head[i] === byte)) return source;
  const text = new TextDecoder("latin1").decode(head);
  const splats = SPLATS.test(name) || SIGNS.test(text);
  if (splats && begin) return imported(source, name, begin());
  throw new ViewerError("NotGsynError", `This is no .gsyn file. ${splats ? `${name} holds another program's splats: \`gsynopsis import ${name}\` makes one of it.` : instead(head, text, name)}`);
}

/** The scene that our own server makes of splats. */
async function imported(source: string | Blob, name: string, signal: AbortSignal): Promise<Blob> {
  const body = typeof source === "string" ? await (await fetch(source, { signal })).blob() : source;
  const answer = await fetch(`import/${encodeURIComponent(name)}`, { method: "POST", body, signal });
  if (!answer.ok) throw new ViewerError("NotGsynError", await answer.text());
  return answer.blob();
}

function instead(head: Uint8Array, text: string, name: string): string {
  if (head[0] === 0x1f && head[1] === 0x8b) return "It is compressed by gzip, for which nobody asked: serve .gsyn files as they are.";
  if (text.startsWith("<")) return `The server sent a page in the place of ${name}.`;
  return ANY;
}

async function headOf(source: string | Blob): Promise<Uint8Array> {
  if (typeof source !== "string") return new Uint8Array(await source.slice(0, HEAD).arrayBuffer());
  const address = source.split("?")[0];
  const give = new AbortController();
  let answer: Response;
  try {
    answer = await fetch(source, { headers: { Range: `bytes=0-${HEAD - 1}` }, cache: "no-cache", signal: give.signal });
  } catch {
    throw new ViewerError("TransientError", unreachable(address));
  }
  const { status, body } = answer;
  // An empty file has no range.
  if (status === 416) return new Uint8Array(0);
  if (!answer.ok) {
    throw new ViewerError("SourceError", `${status === 404 ? "There is no such file" : `The server answers ${status}`}: ${address}`);
  }
  const piece = await body?.getReader().read();
  give.abort();
  return piece?.value?.subarray(0, HEAD) ?? new Uint8Array(0);
}

function unreachable(address: string): string {
  return `${address} cannot be reached: no connection, or the server does not allow this page to read it (CORS).`;
}
