/** Asks a server now and then whether a file is there and whether it is another one. */

export interface FilePollEvents {
  /** The file's version, another than before. */
  changed(version: string): void;
  /** The file is not there, or not any more. */
  missing(known: boolean): void;
  /** The file is there again, in the same version as before. */
  back(): void;
  /** Every poll that found the file ends with this. */
  looked(): void;
}

export class FilePoll {
  private readonly timer: ReturnType<typeof setInterval>;
  private asking = false;
  private missed = false;

  constructor(
    private readonly address: string,
    private readonly events: FilePollEvents,
    /** Milliseconds between two looks. */
    every: number,
    /** The version that is shown already, empty for none. */
    public version = "",
  ) {
    const look = () => { this.look().catch(() => { this.miss(); }); };
    this.timer = setInterval(look, every);
    look();
  }

  /** Tell of the present version again at the next look: it could not be used. */
  forget(): void {
    this.version = "";
  }

  close(): void {
    clearInterval(this.timer);
  }

  private async look(): Promise<void> {
    if (this.asking || document.hidden) return;
    this.asking = true;
    try {
      const { ok, headers } = await fetch(this.address, { method: "HEAD", cache: "no-store" });
      const version = ok ? (headers.get("etag") ?? headers.get("last-modified") ?? "") : "";
      if (!version) {
        this.miss();
        return;
      }
      if (version !== this.version) this.events.changed(version);
      else if (this.missed) this.events.back();
      this.version = version;
      this.missed = false;
      this.events.looked();
    } finally {
      this.asking = false;
    }
  }

  private miss(): void {
    this.missed = true;
    this.events.missing(this.version !== "");
  }
}
