/** Code that the first image does not need: part of the same script, or loaded when it is wanted. */

/** Milliseconds until a script that did not come is requested again. */
const RETRIES = [500, 1000, 2000, 4000];

/** A module that is there already, or is loaded once somebody asks for it. */
export class LazyModule<Module> {
  /** The module, once it is there. */
  now: Module | null = null;
  private load: (() => Promise<Module>) | null = null;
  private loading: Promise<Module> | null = null;

  /** The module is part of this script. */
  provide(module: Module): void {
    this.now = module;
  }

  /** The module comes by `load`. */
  loadBy(load: () => Promise<Module>): void {
    this.load = load;
  }

  get(): Promise<Module> {
    if (this.now) return Promise.resolve(this.now);
    return (this.loading ??= this.fetch());
  }

  private async fetch(): Promise<Module> {
    for (let tries = 0; ; tries++) {
      try {
        return (this.now = await this.load!());
      } catch (error) {
        if (tries === RETRIES.length) throw error;
        await new Promise((resolve) => setTimeout(resolve, RETRIES[tries]));
      }
    }
  }
}
