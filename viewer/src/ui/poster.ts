/** A tiny picture of the first view, out of the manifest, until there is something of the scene; as container/notes/poster.py. */

import { parsePoster } from "../format/notes/poster";
import type { SceneFacts } from "../decode/messages";

/** The poster and the percentage shown from the opening of a file until something of the scene is on screen. */
export class LoadingView {
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
