/** Code that the first picture does not need: part of the same module, or loaded when it is wanted. */

import type * as decoder from "../entry/deferred";

/** Milliseconds until a script that did not come is asked for again. */
const AGAIN = [500, 1000, 2000, 4000];

/** Some modules, now or later. */
export class Later<Module> {
  /** What they give, once they are there. */
  now: Module | null = null;
  private load: (() => Promise<Module>) | null = null;
  private asked: Promise<Module> | null = null;

  /** They are part of this script. */
  provide(module: Module): void {
    this.now = module;
  }

  /** They come by `load`. */
  comesBy(load: () => Promise<Module>): void {
    this.load = load;
  }

  get(): Promise<Module> {
    if (this.now) return Promise.resolve(this.now);
    return (this.asked ??= this.fetch());
  }

  private async fetch(): Promise<Module> {
    for (let tries = 0; ; tries++) {
      try {
        return (this.now = await this.load!());
      } catch (error) {
        if (tries === AGAIN.length) throw error;
        await new Promise((resolve) => setTimeout(resolve, AGAIN[tries]));
      }
    }
  }
}

/** Of a worker: what chooses what to fetch, and the kernel without WebAssembly. */
export const laterDecoder = new Later<typeof decoder>();
