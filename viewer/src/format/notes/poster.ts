/** The manifest's note `poster`: a tiny image of the first view; as container/notes/poster.py. */

import { POSTER_BYTES_MAX, POSTER_PIXELS_MAX } from "../layout.gen";

/** First bytes of a WebP file with one lossy frame. */
const HEAD = 30;
/** Bytes that they hold by place: RIFF; WEBPVP8 and a space; the start code of a frame. */
const WORDS = [[0, 0x52, 0x49, 0x46, 0x46], [8, 0x57, 0x45, 0x42, 0x50, 0x56, 0x50, 0x38, 0x20], [23, 0x9d, 0x01, 0x2a]];
const BASE64 = /^(?:[A-Za-z0-9+/]{4})*(?:[A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?$/;

/** The WebP file in the note; null if it is not the one form that is shown. */
export function parsePoster(text: string | undefined): Uint8Array<ArrayBuffer> | null {
  if (text === undefined || text.length > 2 * POSTER_BYTES_MAX || !BASE64.test(text)) return null;
  const data = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  if (data.length < HEAD || data.length > POSTER_BYTES_MAX) return null;
  if (!WORDS.every(([at, ...word]) => word.every((byte, i) => data[at + i] === byte))) return null;
  const view = new DataView(data.buffer);
  const frame = view.getUint32(16, true);
  const whole = view.getUint32(4, true) === data.length - 8 && frame + (frame % 2) === data.length - 20;
  const sides = [26, 28].map((at) => view.getUint16(at, true) & 0x3fff);
  const fits = sides.every((side) => side >= 1 && side <= POSTER_PIXELS_MAX);
  return whole && fits && !(data[20] & 1) ? data : null;
}
