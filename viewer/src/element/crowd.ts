/** Many elements on one page: some have a graphics device, the others show their last picture until they are touched. */

import type { SceneView } from "../render/scene-view";

/** An element that takes turns. */
export interface Member extends HTMLElement {
  readonly scene: SceneView | null;
}

/** Elements that wait for a device, in order. */
const waiting: { readonly element: Member; readonly start: () => void }[] = [];
/** Those that have shown all of their scene. */
const done = new Set<Member>();

export class Crowd {
  constructor(private readonly drawing: Set<Member>) {}

  /** Start once there is a device for an element. */
  queue(element: Member, start: () => void, first = false): void {
    if (waiting.some((each) => each.element === element)) return;
    if (first) waiting.unshift({ element, start });
    else waiting.push({ element, start });
    this.look();
  }

  /** An element has shown all of its scene: others may have its device. */
  finished(element: Member): void {
    done.add(element);
    this.look();
  }

  /** Somebody touches an element that shows a picture. */
  wake(element: Member): void {
    const { scene } = element;
    if (!scene?.resting) return;
    this.queue(element, () => {
      this.drawing.add(element);
      scene.rest(false);
    }, true);
  }

  /** Give devices to those that wait, and take them from those that nobody touches. */
  look(): void {
    while (waiting.length) {
      const [{ element, start }] = waiting;
      const idle = [...this.drawing].find((each) => done.has(each) && !each.matches(":hover, :focus-within, :fullscreen"));
      if (!idle) return;
      waiting.shift();
      if (!element.isConnected) continue;
      idle.scene?.rest(true);
      this.drawing.delete(idle);
      start();
    }
  }
}
