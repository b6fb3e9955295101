/** The button of walks: keys and drags are those of somebody on foot meanwhile. */

import type { KeyMoves } from "../camera/key-moves";
import type { Host } from "./host";
import type { Places } from "./places";

export class OnFoot {
  constructor(
    private readonly host: Host,
    private readonly places: Places,
    private readonly keys: KeyMoves,
    private readonly button: HTMLElement,
    private readonly tell: (text: string) => void,
  ) {}

  /** Begin to walk, or end it. */
  toggle(): void {
    const { host, places, keys, button } = this;
    const scene = host.scene();
    if (!scene?.facts) return;
    if (!places.toggleWalk()) this.tell("There is no ground here to walk on.");
    keys.walker = places.walk;
    button.setAttribute("aria-pressed", String(places.walk !== null));
    if (!places.walk) return;
    scene.mover = keys;
    scene.move();
  }

  /** End a walk; false if there was none. */
  end(): boolean {
    const walks = this.places.walk !== null;
    if (walks) this.toggle();
    return walks;
  }
}
