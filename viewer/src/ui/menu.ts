/** The menu of a narrow bar and the list of keys, which open and close. */

import type { Toolbar } from "./toolbar";

export class Menu {
  /** Element that had the focus before the list of keys was opened. */
  private before: HTMLElement | null = null;

  constructor(private readonly parts: Toolbar) {
    const { menu, more, help, bar } = parts;
    menu.addEventListener("click", () => { this.open(!more.classList.contains("open")); });
    more.addEventListener("click", () => { this.open(false); });
    this.closer.addEventListener("click", () => { this.help(false); });
    for (const part of [help, bar]) {
      part.addEventListener("keydown", (event) => {
        if (event.key === "Escape" && this.close()) event.preventDefault();
      });
    }
    // As menus do elsewhere: a touch beside it closes it.
    parts.stage.addEventListener("pointerdown", () => { this.open(false); });
  }

  /** Close what is open; false if nothing was. */
  close(): boolean {
    const { more, menu, help } = this.parts;
    if (!help.hidden) {
      this.help(false);
      return true;
    }
    if (!more.classList.contains("open")) return false;
    this.open(false);
    menu.focus();
    return true;
  }

  /** Show or hide the list of keys; without a word the other of both. */
  help(shown = this.parts.help.hidden): void {
    const { help, buttons, stage, bar, menu } = this.parts;
    if (shown === !help.hidden) return;
    const root = help.getRootNode() as ShadowRoot;
    if (shown) this.before = root.activeElement instanceof HTMLElement ? root.activeElement : stage;
    help.hidden = !shown;
    buttons.get("help")?.setAttribute("aria-expanded", String(shown));
    if (shown) this.closer.focus({ preventScroll: true });
    else {
      const back = this.before?.checkVisibility() ? this.before : bar.hidden ? stage : menu;
      back.focus({ preventScroll: true });
    }
  }

  private get closer(): HTMLButtonElement {
    return this.parts.help.querySelector(".close")!;
  }

  private open(shown: boolean): void {
    const { more, menu } = this.parts;
    more.classList.toggle("open", shown);
    menu.setAttribute("aria-expanded", String(shown));
    const { activeElement } = more.getRootNode() as ShadowRoot;
    if (more.contains(activeElement) && !activeElement?.checkVisibility()) menu.focus();
  }
}
