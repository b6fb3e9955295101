/** A file that is written anew while it is shown, such as that of a training. */

import { TrainingPanel } from "./training-panel";
import { FilePoll } from "./poll";

/** Seconds between two looks for a newer version, where nobody says otherwise. */
const SECONDS = 2;
const NOT_YET = "There is nothing to show yet; this page looks again.";
const GONE = "The file cannot be reached any more; this is the last picture of it.";

export interface LiveEvents {
  /** Another version is there, at an address of its own. */
  open(address: string, name: string): void;
  say(text: string): void;
  /** Bytes of the version on screen, 0 if there is none. */
  shown(): number;
}

export class LiveReload {
  private readonly watch: FilePoll;
  private readonly training: TrainingPanel;

  /** Looks every so many seconds; `version` is on screen already; a training's figures go to `place`. */
  constructor(file: URL, place: HTMLElement, events: LiveEvents, seconds: number, version = "") {
    const address = new URL(file);
    const name = address.pathname.split("/").pop() ?? "";
    this.training = new TrainingPanel(file, place);
    this.watch = new FilePoll(file.href, {
      changed: (found) => {
        // So that no cache joins two versions.
        address.searchParams.set("version", found);
        events.open(address.href, name);
      },
      missing: (known) => { events.say(known ? GONE : NOT_YET); },
      back: () => { events.say(""); },
      looked: () => { this.training.look(events.shown()).catch(() => undefined); },
    }, 1000 * (seconds || SECONDS), version);
  }

  get version(): string {
    return this.watch.version;
  }

  /** The version on screen could not be used: take it again when it is there. */
  forget(): void {
    this.watch.forget();
  }

  close(): void {
    this.watch.close();
    this.training.close();
  }
}
