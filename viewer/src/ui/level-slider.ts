/** The finest level that is shown, as the slider says it. */

import type { Toolbar } from "./toolbar";

export class LevelSlider {
  /** Levels to choose from, 0 before the file's header. */
  private known = 0;

  constructor(
    private readonly parts: Toolbar,
    /** Show no finer level; the text is what people read. */
    private readonly chosen: (level: number, text: string) => void,
  ) {
    parts.level.addEventListener("input", () => { this.show(); });
  }

  /** Another file comes. */
  forget(): void {
    this.known = 0;
  }

  /** Levels 0 … most; a choice made before stays, the first one is `wanted`. */
  setMost(most: number, wanted: string | null): void {
    const { level } = this.parts;
    const before = Number(level.value);
    const kept = before > this.known - 1 ? "auto" : String(before);
    const first = !this.known;
    this.known = most + 1;
    level.min = "0";
    level.max = String(most + 1);
    this.choose(first ? wanted : kept);
  }

  /** `auto`, or the number of a level. */
  choose(wanted: string | null): void {
    if (!this.known) return;
    const most = this.known - 1;
    const auto = wanted === null || wanted === "auto" || !Number.isInteger(Number(wanted));
    this.parts.level.value = String(auto ? most + 1 : Math.min(most, Math.max(0, Number(wanted))));
    this.show();
  }

  private show(): void {
    const { level, levelName } = this.parts;
    const most = Number(level.max) - 1;
    const number = Number(level.value);
    const text = number > most ? "auto" : `L${number}`;
    levelName.textContent = text;
    level.setAttribute("aria-valuetext", text);
    this.chosen(Math.min(number, most), text);
  }
}
