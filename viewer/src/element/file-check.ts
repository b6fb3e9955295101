/** A look at the first bytes of a file, before it takes the place of a scene; and words for what it is instead. */

import { ViewerError } from "../base/errors";
import { MAGIC } from "../format/layout.gen";

/** Bytes that tell what a file is. */
const HEAD = 16;
const SPLATS = /\.(ply|splat|ksplat|spz|sog|lcc|glb|gltf)$/i;
const ANY = "`gsynopsis import FILE` makes one of PLY, SPZ, SOG and other splats.";

/** Why a file cannot be a scene; null where its first bytes are one's. Rejects where it cannot be read. */
export async function refusalOf(source: string | Blob, name: string): Promise<ViewerError | null> {
  const head = await headOf(source);
  if (!head.length) return new ViewerError("TruncatedError", `${name} is incomplete: it has 0 bytes.`);
  if (MAGIC.every((byte, i) => i >= head.length || head[i] === byte)) return null;
  return new ViewerError("NotGsynError", `This is no .gsyn file. ${instead(head, name)}`);
}

function instead(head: Uint8Array, name: string): string {
  const text = new TextDecoder("latin1").decode(head);
  const splats = SPLATS.test(name) || text.startsWith("ply");
  if (splats) return `${name} holds another program's splats: \`gsynopsis import ${name}\` makes one of it.`;
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
