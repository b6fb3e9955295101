/** A scene on a canvas: workers, camera, frames. Everything but buttons and words. */

import { Camera, viewPoseOf } from "../camera/camera";
import type { Pinhole } from "../camera/camera";
import { Controls } from "../camera/controls";
import { takePreloadedResponse } from "../fetch/preloaded-response";
import { ViewerError, asViewerError } from "../base/errors";
import { DecoderClient, workerStopped } from "../decode/client";
import type { SceneOptions, SceneEvents } from "./scene-options";
import type { FromDecoder, SceneFacts, Side, Sorted, ToDecoder, ToSorter } from "../decode/messages";
import { SideView, capacityOf, roomWithin } from "./side";
import { Renderer } from "./renderer";
import type { AnyRenderer, Backend, Frame, SorterPort } from "./backend";
import { FramePace } from "./frame-pace";
import { ContextLossSnapshot } from "./context-loss-snapshot";
import { PictureWaiters } from "./picture-waiters";
import { visitStation } from "../camera/viewpoints";
import { spawnWorker } from "../decode/spawn-worker";

/** Milliseconds between two views that the decoder hears of. */
const VIEW_EVERY = 100;
const LOST = "The graphics device was lost. This picture stays until it is back.";

export class SceneView {
  readonly camera = new Camera([0, -1, 0]);
  /** Moves the camera from frame to frame: keys that are held, or a way to another place. */
  mover: { readonly active: boolean; step(camera: Camera, seconds: number): void } | null = null;
  facts: SceneFacts | null = null;
  /** More of the file is to come. */
  waits = false;
  /** Seconds of the last decoding. */
  decodeSeconds = 0;
  memory = { tables: 0, decoded: 0, kernel: "", workers: 1 };
  /** Share of the width, from the left, that shows the other level. */
  divider = 0.5;
  renderer: AnyRenderer;
  private readonly feed: DecoderClient;
  private readonly started = performance.now();
  private readonly ends = new AbortController();
  readonly picture: ContextLossSnapshot;
  panes: [SideView | null, SideView | null] = [null, null];
  /** Levels asked for, the other one null where there is none. */
  readonly caps: [number, number | null] = [Infinity, null];
  private epoch = 0;
  serial = 0;
  private needed = true;
  private moving = 0;
  private toldAt = 0;
  private told = false;
  lastFrame = 0;
  readonly pace = new FramePace();
  private baseShown = false;
  private baseWaits = false;
  lost = false;
  /** The device is lent to other scenes. */
  resting = false;
  private hold = false;
  /** Draws in place of the canvas for somebody whose own frames call `frame`. */
  painter: ((frame: Frame) => void) | null = null;
  unkept = true;
  private fixed: Pinhole | null = null;
  private readonly waiters = new PictureWaiters();
  handle = 0;

  constructor(
    readonly canvas: HTMLCanvasElement,
    surface: HTMLElement,
    private options: SceneOptions,
    readonly events: SceneEvents,
    private readonly backend?: Backend,
    private readonly sorter: SorterPort = backend?.sorter ?? spawnWorker(),
  ) {
    const { signal } = this.ends;
    this.camera.byLonger = options.byLonger;
    this.renderer = this.makeRenderer();
    this.picture = new ContextLossSnapshot(this);
    new Controls(surface, this.camera, () => { this.move(); }, options.takesWheel, signal);
    this.feed = new DecoderClient((message) => { this.guard(() => { this.take(message); }); }, (error) => { events.error(error); });
    this.sorter.onmessage = (event: MessageEvent<Sorted>) => { this.guard(() => { this.takeOrder(event.data); }); };
    this.sorter.onerror = (event) => { events.error(workerStopped(event)); };
    canvas.addEventListener("webglcontextlost", (event) => { this.lose(event); }, { signal });
    canvas.addEventListener("webglcontextrestored", () => { this.guard(() => { this.restore(); }); }, { signal });
    document.addEventListener("visibilitychange", () => {
      this.feed.tell({ type: "pause", paused: document.hidden });
      this.wake();
    }, { signal });
    this.wake();
  }

  open(source: string | Blob, name: string): void {
    const preloaded = typeof source === "string" ? takePreloadedResponse(source) : null;
    this.feed.tell({ ...this.orderOf(source, name), preloaded }, preloaded ? [preloaded.port] : []);
  }

  /** Show a newer version of the file as soon as all of it is decoded; the camera stays. */
  replace(source: string | Blob, name: string): Promise<boolean> {
    return this.feed.replace(this.orderOf(source, name), viewPoseOf(this.pinhole()));
  }

  /** Most splats of what is opened from now on. */
  set budget(budget: number) {
    this.options = { ...this.options, budget };
  }

  /** Show no finer than a level. */
  setLevel(cap: number): void {
    this.caps[0] = cap;
    this.feed.tell({ type: "level", side: 0, cap, serial: ++this.serial });
  }

  /** Show another level left of the divider, or none. */
  compare(cap: number | null): void {
    this.caps[1] = cap;
    if (cap === null && this.panes[1]) {
      this.panes[1] = null;
      this.renderer.drop(1);
      this.tellSorter({ type: "drop", side: 1 });
    }
    if (!this.facts) return;
    if (cap !== null) this.panes[1] ??= this.makePane(1, this.facts);
    this.feed.tell({ type: "level", side: 1, cap, serial: ++this.serial });
    this.wake();
  }

  /** Draw exactly this camera from now on; null gives it back to the person. */
  setPinhole(pinhole: Pinhole | null): void {
    this.fixed = pinhole;
    this.tellView(true);
  }

  /** The camera of the next frame. */
  pinhole(): Pinhole {
    return this.fixed ?? this.camera.pinhole(this.canvas.width, this.canvas.height);
  }

  /** Splats in the last sorted orders. */
  get drawn(): number {
    return this.panes.reduce((sum, pane) => sum + (pane?.drawn ?? 0), 0);
  }

  /** Resolves when what was asked for last is decoded, sorted and drawn, all of it faded in. */
  settled(): Promise<void> {
    this.tellView(true);
    return this.waiters.add(this.serial);
  }

  /** The present picture, RGBA8 [height, width, 4], every change in it done unless `now`. */
  capture(now = false): { width: number; height: number; pixels: Uint8ClampedArray | Promise<Uint8ClampedArray> } {
    const { width, height } = this.pinhole();
    return { width, height, pixels: this.renderer.capture({ ...this.frameOf(), time: this.seconds() + (now ? 0 : 1e3) }) };
  }

  /** A place of a round of the scene's own cameras, 0 … 1; 0 is the first view, a photo's where one is known. */
  visit(turn: number): void {
    if (!this.facts) return;
    visitStation(this.camera, this.facts, turn, this.options.free);
    this.move();
  }

  /** Something changed that the next frame shows. */
  wake(): void {
    this.needed = true;
    if (!this.handle && !this.painter && !document.hidden) this.handle = requestAnimationFrame((now) => { this.frame(now); });
  }

  move(): void {
    this.moving = performance.now();
    this.told = false;
    this.wake();
  }

  close(): void {
    cancelAnimationFrame(this.handle);
    this.handle = -1;
    this.ends.abort();
    this.feed.close();
    this.sorter.terminate();
    this.picture.close();
    this.renderer.close();
  }

  private makeRenderer(): AnyRenderer {
    const renderer = this.backend?.make(this.canvas, this.events) ?? Renderer.create(this.canvas);
    if (this.options.still) renderer.fade = 0;
    return renderer;
  }

  private orderOf(source: string | Blob, name: string): Extract<ToDecoder, { type: "open" }> {
    const { plain, budget } = this.options;
    return { type: "open", source, name, budget: Math.min(budget, roomWithin(this.renderer.most)), plain, cores: navigator.hardwareConcurrency };
  }

  private makePane(side: Side, facts: SceneFacts): SideView {
    const row = () => this.pinhole().w2c.slice(8, 12);
    // Sorted a little before a picture may be drawn.
    const idles = () => this.waits && this.skips(1.3 * (performance.now() - this.lastFrame));
    return new SideView(side, ++this.epoch, capacityOf(facts, facts.most), row, (message, transfer) => { this.tellSorter(message, transfer); }, idles);
  }

  seconds(): number {
    return (performance.now() - this.started) / 1000;
  }

  private tellSorter(message: ToSorter, transfer: Transferable[] = []): void {
    this.sorter.postMessage(message, transfer);
  }

  private tellView(now: boolean): void {
    this.told = true;
    this.toldAt = performance.now();
    this.feed.tell({ type: "view", eye: viewPoseOf(this.pinhole()), serial: ++this.serial, now });
    this.sort();
    this.wake();
  }

  private guard(work: () => void): void {
    try {
      work();
    } catch (error) {
      this.events.error(asViewerError(error));
    }
  }

  private take(message: FromDecoder): void {
    switch (message.type) {
      case "header":
        this.begin(message.facts);
        break;
      case "manifest":
        if (this.facts) this.facts = { ...this.facts, manifest: message.manifest };
        break;
      case "progress":
        this.events.progress(message.progress);
        break;
      case "centers":
        this.renderer.setCenters(message.first, message.centers, () => { this.tellSorter(message, [message.centers.buffer]); });
        this.wake();
        break;
      case "attributes":
        this.decodeSeconds = message.seconds;
        this.panes[message.side]?.take({ ...message, fade: message.fade && !this.pace.isSlow(message.limit) }, this.renderer, () => this.seconds());
        this.wake();
        break;
      case "memory":
        this.memory = message;
        break;
      case "level-ready":
        this.baseWaits ||= message.level === 0;
        this.events.level(message.level, message.bytes, message.seconds);
        // Its order may have been drawn before the word of it, which the next frame passes on.
        this.wake();
        break;
      case "complete":
        this.waits = false;
        this.events.complete(message.bytes, message.seconds);
        break;
      case "notice":
        this.events.notice(message.text);
        break;
      case "error":
        this.events.error(new ViewerError(message.trouble, message.message));
        break;
    }
  }

  private begin(facts: SceneFacts): void {
    // Where something is shown already, it stays until what takes its place is sorted.
    const first = !this.facts;
    this.hold = !first;
    this.waits = true;
    this.facts = this.makeRoom(facts);
    if (first) this.visit(0);
    this.events.header(this.facts);
    this.tellView(true);
    if (this.caps[1] !== null) this.compare(this.caps[1]);
  }

  /** Textures for the finest level that the device's memory holds; the scene with that level. */
  private makeRoom(facts: SceneFacts): SceneFacts {
    let { most } = facts;
    while (!this.renderer.reset(capacityOf(facts, most))) {
      if (!most) throw new ViewerError("DeviceError", "This device has not enough graphics memory for the scene.");
      most--;
    }
    if (most < facts.most) {
      this.events.notice(`This device has not enough graphics memory for all; it shows level ${most} of ${facts.levels.length - 1}.`);
      this.feed.tell({ type: "most", most });
    }
    const found = { ...facts, most };
    this.tellSorter({ type: "reset", capacity: capacityOf(found, most) });
    this.panes = [this.makePane(0, found), null];
    return found;
  }

  private lose(event: Event): void {
    event.preventDefault();
    this.lost = true;
    this.picture.show(true);
    if (this.resting) return;
    console.warn(`gsynopsis: ${LOST}`);
    this.events.notice(LOST);
  }

  private restore(): void {
    this.events.notice("");
    this.renderer = this.makeRenderer();
    if (this.facts) {
      this.facts = this.makeRoom(this.facts);
      if (this.caps[1] !== null) this.compare(this.caps[1]);
    }
    this.feed.tell({ type: "again" });
    this.lost = false;
    this.tellView(true);
  }

  /** Give the graphics device to others until it is called with false; the last picture stays meanwhile. */
  rest(resting: boolean): void {
    if (resting === this.resting) return;
    this.resting = resting;
    if (resting) {
      this.paint(performance.now());
      this.picture.keep(Infinity);
      this.renderer.loss?.loseContext();
    } else this.renderer.loss?.restoreContext();
    this.feed.tell({ type: "pause", paused: resting });
  }

  private sort(): void {
    for (const pane of this.panes) pane?.sort();
  }

  private takeOrder(sorted: Sorted): void {
    const pane = this.panes[sorted.side];
    if (pane?.epoch !== sorted.epoch) return;
    this.feed.tell({ type: "seen" });
    pane.takeOrder(sorted, this.renderer, () => { this.hold &&= sorted.serial < 0; });
    this.wake();
  }

  private get rests(): boolean {
    return !this.painter && performance.now() - this.moving > VIEW_EVERY;
  }

  /** A picture is left out, other than the first of all of the base; `since`: milliseconds since the last. */
  private skips(since: number): boolean {
    return this.rests && this.baseShown === this.baseWaits && this.pace.skips(since, this.drawn);
  }

  frame(now: number): void {
    this.handle = 0;
    const since = now - this.lastFrame;
    if (this.mover?.active) {
      this.mover.step(this.camera, Math.min(since, 100) / 1000);
      this.move();
    }
    // Before it is painted: a change that ends meanwhile has its last frame still to come.
    const seconds = this.seconds();
    this.guard(() => {
      if (!this.lost) this.renderer.give(now);
      for (const pane of this.panes) if (!this.lost) pane?.tidy(this.renderer, seconds);
    });
    const fading = this.panes.some((pane) => pane?.isFading(seconds));
    const follows = this.waits || this.renderer.waits || this.panes.some((pane) => pane?.sorting);
    const paints = !this.lost && !this.hold && !(follows && this.skips(since));
    if (paints) this.guard(() => { this.paint(now); });
    if (paints && this.rests && this.drawn) this.pace.measure(this.renderer, this.drawn);
    if (this.needed || fading || !this.told || this.waiters.any || (this.renderer.waits && !this.lost)) this.wake();
    else if (this.unkept && this.drawn && !(this.waits && this.pace.isSlow(this.drawn))) {
      // Nothing in it moves.
      const wait = this.picture.keep(now);
      if (wait) setTimeout(() => { if (this.unkept) this.wake(); }, wait);
      else this.unkept = false;
    }
  }

  /** The next frame to draw. */
  frameOf(): Frame {
    return { camera: this.pinhole(), time: this.seconds(), divider: this.divider };
  }

  private paint(now: number): void {
    this.needed = false;
    if (!this.told && now - this.toldAt >= VIEW_EVERY) this.tellView(false);
    if (now - this.moving < VIEW_EVERY) this.sort();
    const seconds = this.seconds();
    if (this.painter) this.painter(this.frameOf());
    else this.renderer.draw(this.frameOf());
    if (this.drawn) this.picture.show(false);
    this.unkept = true;
    this.lastFrame = now;
    if (this.baseWaits && !this.baseShown && this.drawn) {
      this.baseShown = true;
      this.events.base(seconds);
      this.renderer.finished().then(() => { this.events.shown(); }, () => undefined);
    }
    const settled = this.panes.every((pane) => !pane || pane.isSettled(seconds));
    if (settled) this.waiters.release(Math.min(...this.panes.map((pane) => pane?.sortedFor ?? Infinity)));
    this.events.frame();
  }
}
