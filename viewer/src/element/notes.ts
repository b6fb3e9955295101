/** Notes on a scene: read from its file, made at a place under the pointer, and saved. */

import { cameraState } from "../camera/camera-api";
import type { Annotation } from "../format/notes/annotations";
import { Annotations } from "../ui/annotations";
import type { Toolbar } from "../ui/toolbar";
import type { Places } from "./places";
import type { SceneView } from "../render/scene-view";
import type { Vec } from "../base/vec3";
import type { Host } from "./host";

/** Milliseconds for which nothing moved before it is looked for what hides a note. */
const REST = 150;

export class Notes {
  readonly cards: Annotations;
  /** View that the dots were last looked at from: the camera, decoded levels, and their number. */
  private seen: readonly unknown[] = [];
  private timer = 0;

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

  /** A frame is drawn: dots go where their places are; once nothing moves, those behind something fade. */
  frame(scene: SceneView): void {
    const { cards, host } = this;
    cards.place(scene.pinhole());
    const { places } = cards;
    const now = [scene.camera.pose, host.done.length, places.length];
    if (now.every((each, i) => each === this.seen[i])) return;
    this.seen = now;
    clearTimeout(this.timer);
    if (places.length) this.timer = window.setTimeout(() => { this.look(places, 0); }, REST);
  }

  close(): void {
    clearTimeout(this.timer);
  }

  /** Look whether one is hidden, and then for the next one: each takes a pass over all splats. */
  private look(places: readonly Vec[], number: number): void {
    this.cards.fade(number, this.places.hides(places[number]));
    if (number + 1 < places.length) this.timer = window.setTimeout(() => { this.look(places, number + 1); });
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
