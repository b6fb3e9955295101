/** Notes on a scene: read from its file, made at a place under the pointer, and saved. */

import { cameraState } from "../camera/camera-api";
import type { Annotation } from "../format/notes/annotations";
import { Annotations } from "../ui/annotations";
import type { Toolbar } from "../ui/toolbar";
import type { Places } from "./places";
import type { Host } from "./host";

export class Notes {
  readonly cards: Annotations;

  constructor(private readonly host: Host, parts: Toolbar, private readonly places: Places, private readonly tell: (text: string) => void) {
    this.cards = new Annotations(parts, {
      visit: (camera) => { places.glideTo(camera); },
      save: (all) => this.save(all),
      say: tell,
      changed: () => { host.scene()?.wake(); },
    });
  }

  /** Write one on what is at a place of the picture, 0 … 1 from its left and upper edge, seen as now. */
  add(x: number, y: number): void {
    const scene = this.host.scene();
    if (!scene?.facts) return;
    const at = this.places.pick(x, y);
    if (!at) {
      this.tell("Nothing is there that a note could be put on.");
      return;
    }
    const { position, target, quaternion } = cameraState(scene.camera);
    this.cards.add(at, { position: [...position], target: [...target], quaternion: [...quaternion] });
  }

  /** Put all of them into the file by way of our own server, else give them to the person; what was done. */
  private async save(all: readonly Annotation[]): Promise<string> {
    const { element } = this.host;
    const text = JSON.stringify(all);
    const src = element.getAttribute("src");
    if (src && element.hasAttribute("edit")) {
      const { origin, pathname } = new URL(src, document.baseURI);
      const headers = { "content-type": "application/json" };
      const answer = await fetch(`${origin}${pathname}/annotations`, { method: "PUT", body: text, headers });
      if (!answer.ok) throw new Error(`Not saved: ${await answer.text()}`);
      return "Saved in the file.";
    }
    download(new Blob([text], { type: "application/json" }), "annotations.json");
    return "`gsynopsis pack FILE --notes annotations.json` puts them into the file.";
  }
}

/** Give a file to the person. */
export function download(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}
