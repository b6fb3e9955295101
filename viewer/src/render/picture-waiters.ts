/** Callers that wait for a picture of what was asked for last when they came. */

export class PictureWaiters {
  private waiting: { readonly serial: number; readonly resolve: () => void }[] = [];

  get any(): boolean {
    return this.waiting.length > 0;
  }

  /** Resolves once a picture follows a serial. */
  add(serial: number): Promise<void> {
    return new Promise((resolve) => this.waiting.push({ serial, resolve }));
  }

  /** A settled picture follows a serial and all before it. */
  release(last: number): void {
    this.waiting = this.waiting.filter(({ serial, resolve }) => {
      if (last < serial) return true;
      resolve();
      return false;
    });
  }
}
