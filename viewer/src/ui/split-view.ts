/** The split view's parts on the page: a divider to drag, and the level to its left. */

import type { Toolbar } from "./toolbar";

const STEP = 0.02;
const STEP_LARGE = 0.1;

export interface SplitEvents {
  /** The divider stands at this share of the width. */
  moved(share: number): void;
  /** The level left of it, null for no split. */
  chosen(level: number | null): void;
}

export class SplitView {
  /** Share of the width, from the left. */
  share = 0.5;
  private on = false;
  private level = 0;

  constructor(
    private readonly parts: Toolbar,
    private readonly events: SplitEvents,
  ) {
    const { divider, left } = parts;
    divider.addEventListener("pointerdown", (event) => {
      try { divider.setPointerCapture(event.pointerId); } catch { /* not a real pointer */ }
    });
    divider.addEventListener("pointermove", (event) => {
      const { left: start, width } = parts.stage.getBoundingClientRect();
      if (event.buttons & 1 || event.pointerType === "touch") this.move((event.clientX - start) / (width || 1));
    });
    divider.addEventListener("keydown", (event) => { this.press(event); });
    left.max = "0";
    left.addEventListener("input", () => {
      this.level = Number(left.value);
      this.choose();
    });
    this.toggle(false);
  }

  get active(): boolean {
    return this.on;
  }

  /** Levels to choose from, 0 … most. */
  setMost(most: number): void {
    const { left } = this.parts;
    left.max = String(most);
    if (this.on) this.choose();
  }

  /** Show or hide it; `level` is what it compares with. */
  toggle(on: boolean, level?: number): void {
    const { divider, left, leftName, buttons, bar } = this.parts;
    this.on = on;
    bar.classList.toggle("split", on);
    if (level !== undefined) this.level = level;
    divider.hidden = !on;
    left.parentElement!.hidden = leftName.hidden = !on;
    buttons.get("split")?.setAttribute("aria-pressed", String(on));
    this.move(this.share);
    if (on) this.choose();
    else this.events.chosen(null);
  }

  /** Name of the right side. */
  name(right: string): void {
    this.parts.divider.dataset.right = right;
  }

  move(share: number): void {
    this.share = Math.min(1, Math.max(0, share));
    const { divider } = this.parts;
    const percent = Math.round(100 * this.share);
    divider.style.left = `${100 * this.share}%`;
    divider.setAttribute("aria-valuenow", String(percent));
    divider.setAttribute("aria-valuetext", `${percent} %`);
    this.events.moved(this.share);
  }

  private choose(): void {
    const { left, leftName, divider } = this.parts;
    left.value = String(this.level);
    const level = Number(left.value);
    leftName.textContent = divider.dataset.left = `L${level}`;
    left.setAttribute("aria-valuetext", `L${level}`);
    this.events.chosen(level);
  }

  private press(event: KeyboardEvent): void {
    const step = event.shiftKey ? STEP_LARGE : STEP;
    const ways: Record<string, number> = {
      ArrowLeft: this.share - step,
      ArrowRight: this.share + step,
      Home: 0,
      End: 1,
    };
    if (!(event.key in ways) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.move(ways[event.key]);
  }
}
