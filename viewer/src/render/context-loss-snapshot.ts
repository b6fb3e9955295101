/** The last good picture, kept in memory for the time in which the graphics device is lost. */

/** Milliseconds between two pictures kept, at least: each is read back from the device. */
const EVERY = 1000;

export class ContextLossSnapshot {
  private readonly copy = document.createElement("canvas");
  keptAt = -EVERY;

  constructor(private readonly scene: { readonly renderer: { readonly canvas: HTMLCanvasElement } }) {
    this.copy.className = "still";
    this.copy.hidden = true;
    scene.renderer.canvas.after(this.copy);
  }

  /** Keep what was drawn in this task; gives the milliseconds to wait where it is too soon, else 0. */
  keep(now: number): number {
    if (now - this.keptAt < EVERY) return this.keptAt + EVERY - now;
    const { copy } = this;
    const { canvas } = this.scene.renderer;
    // In main memory: a copy on the device would be lost with it.
    const pen = copy.getContext("2d", { willReadFrequently: true });
    copy.width = canvas.width;
    copy.height = canvas.height;
    pen?.drawImage(canvas, 0, 0);
    this.keptAt = now;
    return 0;
  }

  /** Show it in place of the canvas, or the canvas again. */
  show(visible: boolean): void {
    this.copy.hidden = !visible;
    // What is clear in the copy must not show a lost canvas, on which browsers draw a sign.
    this.scene.renderer.canvas.style.visibility = visible ? "hidden" : "";
  }

  close(): void {
    this.copy.remove();
  }
}
