/** A scene for an engine that draws it itself: loaded, decoded and sorted by workers for the engine's camera. */

import type { Pinhole } from "../camera/camera";
import { viewPoseThrough } from "./mesh";
import { ViewerError } from "../base/errors";
import { DecoderClient, workerStopped } from "../decode/client";
import type { FromDecoder, Progress, SceneFacts, Sorted, ToSorter } from "../decode/messages";
import { PictureWaiters } from "../render/picture-waiters";
import { SideView, capacityOf } from "../render/side";
import { SplatTables } from "./splat-tables";
import { spawnWorker } from "../decode/spawn-worker";

/** Milliseconds between two views that the decoder hears of. */
const VIEW_EVERY = 100;
/** Splats at most where nobody says otherwise. */
const BUDGET = 2_000_000;

export interface SplatsOptions {
  /** Most splats; levels above it are not loaded. */
  readonly budget?: number;
  /** Finest level shown. */
  readonly level?: number;
}

/** Events of a scene; all calls come after the constructor has returned. */
export interface SplatsEvents {
  /** The file is known; `Splats.tables` are there from now on. */
  header(facts: SceneFacts): void;
  /** The coarsest level can be drawn. */
  base(bytes: number, seconds: number): void;
  level(level: number, bytes: number, seconds: number): void;
  complete(bytes: number, seconds: number): void;
  progress(progress: Progress): void;
  /** A sentence for people on trouble that may pass; empty when it has. */
  notice(text: string): void;
  error(error: ViewerError): void;
  /** The next picture will be another one. */
  changed(): void;
}

/** One file on its way to the screen. `close` ends its workers; calls after it do nothing. */
export class Splats {
  facts: SceneFacts | null = null;
  tables: SplatTables | null = null;
  private readonly feed: DecoderClient;
  private readonly sorter = spawnWorker();
  private pane: SideView | null = null;
  private base: { bytes: number; seconds: number } | null = null;
  private camera: Pinhole | null = null;
  private told = true;
  private toldAt = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private serial = 0;
  private closed = false;
  private readonly waiters = new PictureWaiters();

  /** `source`: the file's address, or the file. */
  constructor(
    source: string | Blob,
    options: SplatsOptions,
    private readonly events: SplatsEvents,
  ) {
    this.feed = new DecoderClient((message) => { this.take(message); }, (error) => { this.events.error(error); });
    this.sorter.onmessage = (event: MessageEvent<Sorted>) => { this.takeOrder(event.data); };
    this.sorter.onerror = (event) => { this.events.error(workerStopped(event)); };
    // A worker's own address is no base for relative ones.
    const address = typeof source === "string" ? new URL(source, document.baseURI).href : source;
    const name = typeof source === "string" ? source : "";
    this.feed.tell({ type: "open", source: address, name, budget: options.budget ?? BUDGET, plain: false, cores: navigator.hardwareConcurrency });
    if (options.level !== undefined) this.setLevel(options.level);
  }

  /** Show no finer than a level. */
  setLevel(cap: number): void {
    if (!this.closed) this.feed.tell({ type: "level", side: 0, cap, serial: ++this.serial });
  }

  /** This camera draws the next picture. */
  look(camera: Pinhole): void {
    const before = this.camera;
    if (this.closed || (before && isSame(before, camera))) return;
    this.camera = camera;
    this.told = false;
    const wait = this.toldAt + VIEW_EVERY - performance.now();
    if (wait <= 0) this.tell(false);
    else {
      this.pane?.sort();
      // An engine may draw no other picture.
      this.timer ??= setTimeout(() => { this.tell(false); }, wait);
    }
  }

  /** Resolves when what was asked for last is decoded and sorted for the last camera. */
  settled(): Promise<void> {
    this.tell(true);
    return this.waiters.add(this.serial);
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.timer);
    this.feed.close();
    this.sorter.terminate();
    this.pane = this.tables = null;
  }

  /** Tell decoder and sorter of the camera, if they do not know it. */
  private tell(now: boolean): void {
    const { camera } = this;
    clearTimeout(this.timer);
    this.timer = undefined;
    if (!camera || this.closed || (this.told && !now)) return;
    this.told = true;
    this.toldAt = performance.now();
    this.feed.tell({ type: "view", eye: viewPoseThrough(camera), serial: ++this.serial, now });
    this.pane?.sort();
  }

  private tellSorter(message: ToSorter, transfer: Transferable[] = []): void {
    this.sorter.postMessage(message, transfer);
  }

  private take(message: FromDecoder): void {
    const { events } = this;
    switch (message.type) {
      case "header":
        this.begin(message.facts);
        break;
      case "manifest":
        if (this.facts) this.facts = { ...this.facts, manifest: message.manifest };
        break;
      case "centers":
        this.tables?.setCenters(message.first, message.centers);
        this.tellSorter(message, [message.centers.buffer]);
        break;
      case "attributes":
        if (this.tables) this.pane?.take(message, this.tables, () => 0);
        break;
      case "level-ready":
        if (!message.level) this.base = message;
        events.level(message.level, message.bytes, message.seconds);
        // Its order may have come before the word of it, and be the last for long.
        if (this.pane?.isSettled(0)) this.tellBase();
        break;
      case "complete":
        events.complete(message.bytes, message.seconds);
        break;
      case "progress":
        events.progress(message.progress);
        break;
      case "notice":
        events.notice(message.text);
        break;
      case "error":
        events.error(new ViewerError(message.trouble, message.message));
        break;
      case "memory":
        break;
    }
  }

  private begin(facts: SceneFacts): void {
    const { events } = this;
    const capacity = capacityOf(facts, facts.most);
    this.facts = facts;
    this.tables = new SplatTables(capacity);
    this.tellSorter({ type: "reset", capacity });
    // Nothing is decoded, let alone sorted, before there is a camera.
    const row = () => this.camera!.w2c.slice(8, 12);
    this.pane = new SideView(0, 0, capacity, row, (message, transfer) => { this.tellSorter(message, transfer); });
    events.header(facts);
    events.changed();
  }

  /** Say once that the coarsest level can be drawn, when it can. */
  private tellBase(): void {
    const { base, pane } = this;
    if (!base || !pane?.drawn) return;
    this.base = null;
    this.events.base(base.bytes, base.seconds);
  }

  private takeOrder(sorted: Sorted): void {
    const { pane, tables } = this;
    if (!pane || !tables) return;
    pane.takeOrder(sorted, tables, () => { this.feed.tell({ type: "seen" }); });
    this.tellBase();
    if (pane.isSettled(0)) this.waiters.release(pane.sortedFor);
    this.events.changed();
  }
}

function isSame(a: Pinhole, b: Pinhole): boolean {
  const sizes = (["width", "height", "fx", "fy", "cx", "cy"] as const).every((name) => a[name] === b[name]);
  return sizes && a.w2c.every((value, i) => value === b.w2c[i]);
}
