/** A tiny picture of the first view, out of the manifest, until there is something of the scene; as container/poster.py. */

import { POSTER_BYTES_MAX, POSTER_PIXELS_MAX } from "../format/layout.gen";
import type { SceneFacts } from "../decode/messages";

const HEAD = 30;
/** RIFF; WEBPVP8 and a space; the start code of a frame. */
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

/** What a page shows from the opening of a file until something of the scene is on screen. */
export class Waiting {
  private poster: HTMLCanvasElement | null = null;
  private over = false;
  /** Bytes of the base, and those that came. */
  private base = 0;
  private bytes = 0;

  constructor(private readonly say: (text: string) => void) {}

  begin(): void {
    this.end();
    this.over = false;
    this.base = this.bytes = 0;
  }

  came(bytes: number): void {
    this.bytes = bytes;
    if (!this.over && this.base) this.say(`Loading… ${Math.min(99, Math.floor((100 * bytes) / this.base))} %`);
  }

  /** Put the poster, if there is one, behind a canvas, and tell how much has come from now on. */
  show(canvas: HTMLCanvasElement, { manifest, levels }: SceneFacts): void {
    this.base = levels[0].end;
    this.came(this.bytes);
    const data = parsePoster(manifest?.meta.poster);
    if (!data || this.over) return;
    const poster = document.createElement("canvas");
    poster.className = "poster";
    // Pixels alone: nothing of the file becomes part of the page.
    createImageBitmap(new Blob([data], { type: "image/webp" })).then((bitmap) => {
      [poster.width, poster.height] = [bitmap.width, bitmap.height];
      poster.getContext("2d")?.drawImage(bitmap, 0, 0);
      bitmap.close();
    }).catch(() => { poster.remove(); });
    canvas.before(poster);
    this.poster = poster;
  }

  end(): void {
    this.over = true;
    this.poster?.remove();
    this.poster = null;
  }
}
