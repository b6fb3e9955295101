/** A scene on a canvas: workers, camera, frames. Everything but buttons and words. */

import { Camera, add, eyeOf } from "./camera";
import type { Vec } from "./camera";
import { Controls } from "./controls";
import { ViewerError, asViewerError } from "./errors";
import { PAGE } from "./decoder";
import type { Attributes, FromDecoder, Progress, SceneFacts, Sorted, ToDecoder, ToSorter } from "./messages";
import { NEAR, Renderer } from "./renderer";
import type { Pinhole } from "./renderer";
import { ROW } from "./shaders";
import { circleOf, poseOnCircle } from "./viewpoints";
import { makeWorker } from "./workers";

export interface SceneEvents {
  header(facts: SceneFacts): void;
  progress(progress: Progress): void;
  /** The decoded base is on screen. */
  base(seconds: number): void;
  level(level: number, bytes: number, seconds: number): void;
  complete(bytes: number, seconds: number): void;
  notice(text: string): void;
  error(error: ViewerError): void;
  frame(): void;
}

/** Milliseconds between two views that the decoder hears of. */
const VIEW_EVERY = 100;

export interface Options {
  readonly budget: number;
  readonly plain: boolean;
  readonly background: readonly number[];
}

export class Scene {
  readonly camera = new Camera([0, -1, 0]);
  readonly controls: Controls;
  facts: SceneFacts | null = null;
  /** Splats in the last sorted order. */
  drawn = 0;
  /** Seconds of the last decoding. */
  decodeSeconds = 0;
  memory = { tables: 0, decoded: 0, kernel: "" };
  framesPerSecond = 0;
  private readonly renderer: Renderer;
  private readonly decoder = makeWorker();
  private readonly sorter = makeWorker();
  private readonly started = performance.now();
  private serial = 0;
  /** What the pictures drawn now follow. */
  private shown = 0;
  private sortedFor = 0;
  private sorting = false;
  private resort = false;
  private spare: Uint32Array | null = null;
  private limit = 0;
  private needed = true;
  private moving = 0;
  private toldAt = 0;
  private told = false;
  private fadeUntil = 0;
  private baseShown = false;
  private baseWaits = false;
  private fixed: Pinhole | null = null;
  private waiting: { serial: number; resolve: () => void }[] = [];
  private handle = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    surface: HTMLElement,
    private readonly options: Options,
    private readonly events: SceneEvents,
  ) {
    this.renderer = Renderer.create(canvas);
    this.controls = new Controls(surface, this.camera, () => { this.move(); });
    this.decoder.onmessage = (event: MessageEvent<FromDecoder>) => { this.guard(() => { this.take(event.data); }); };
    this.sorter.onmessage = (event: MessageEvent<Sorted>) => { this.guard(() => { this.takeOrder(event.data); }); };
    for (const worker of [this.decoder, this.sorter]) {
      worker.onerror = (event) => {
        events.error(new ViewerError("DeviceError", `The viewer's worker stopped: ${event.message || "it could not start"}.`));
      };
    }
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      events.error(new ViewerError("DeviceError", "The graphics device was lost; reload the page to go on."));
    });
    document.addEventListener("visibilitychange", () => {
      this.tell({ type: "pause", paused: document.hidden });
      this.wake();
    });
    this.wake();
  }

  open(source: string | Blob, name: string): void {
    const { plain } = this.options;
    const budget = Math.min(this.options.budget, this.renderer.most);
    this.tell({ type: "open", source, name, budget, plain });
  }

  /** Show no finer than a level. */
  setLevel(cap: number): void {
    this.tell({ type: "level", cap, serial: ++this.serial });
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

  /** Resolves when what was asked for last is decoded, sorted and drawn, all of it faded in. */
  settled(): Promise<void> {
    this.tellView(true);
    const { serial } = this;
    return new Promise((resolve) => this.waiting.push({ serial, resolve }));
  }

  /** The present picture, RGBA8 [height, width, 4]. */
  capture(): { width: number; height: number; pixels: Uint8ClampedArray } {
    const pinhole = this.pinhole();
    const pixels = this.renderer.capture(pinhole, this.seconds() + 1e3, this.options.background);
    return { width: pinhole.width, height: pinhole.height, pixels };
  }

  /** A place of the scene's own circle of cameras, 0 … 1 around it; 0 is the first view. */
  visit(turn: number): void {
    if (!this.facts) return;
    const circle = circleOf(this.facts);
    this.camera.up = circle.up;
    this.camera.pose = poseOnCircle(circle, turn);
    this.move();
  }

  /** Look at all of the scene from the present direction. */
  fit(): void {
    if (!this.facts) return;
    const { center, radius } = this.facts;
    const { camera } = this;
    const distance = radius / Math.sin(camera.fov / 2);
    const position = add(center as Vec, camera.pose.forward, -distance);
    camera.pose = { ...camera.pose, position, distance };
    this.move();
  }

  /** Something changed that the next frame shows. */
  wake(): void {
    this.needed = true;
    if (!this.handle && !document.hidden) this.handle = requestAnimationFrame((now) => { this.frame(now); });
  }

  move(): void {
    this.moving = performance.now();
    this.told = false;
    this.wake();
  }

  close(): void {
    cancelAnimationFrame(this.handle);
    this.handle = -1;
    this.decoder.terminate();
    this.sorter.terminate();
  }

  private seconds(): number {
    return (performance.now() - this.started) / 1000;
  }

  private tell(message: ToDecoder): void {
    this.decoder.postMessage(message);
  }

  private tellSorter(message: ToSorter, transfer: Transferable[] = []): void {
    this.sorter.postMessage(message, transfer);
  }

  private tellView(now: boolean): void {
    this.told = true;
    this.toldAt = performance.now();
    this.tell({ type: "view", eye: eyeOf(this.pinhole()), serial: ++this.serial, now });
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
        this.takeCenters(message.first, message.centers);
        break;
      case "attributes":
        this.takeAttributes(message.pieces, message.limit, message.serial, message.seconds);
        break;
      case "memory":
        this.memory = message;
        break;
      case "level-ready":
        this.baseWaits ||= message.level === 0;
        this.events.level(message.level, message.bytes, message.seconds);
        break;
      case "complete":
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
    this.facts = facts;
    const capacity = Math.ceil(facts.levels[facts.most].live / PAGE + 1) * PAGE;
    this.renderer.reset(capacity);
    this.spare = new Uint32Array(Math.ceil(capacity / ROW) * ROW);
    this.tellSorter({ type: "reset", capacity });
    this.visit(0);
    this.events.header(facts);
    this.tellView(true);
  }

  private takeCenters(first: number, centers: Float32Array): void {
    const { limit } = this;
    const now = this.seconds();
    // What is decoded as a whole appears as a whole; refinements fade in.
    this.renderer.setCenters(first, centers, first < limit || !limit ? -10 : now);
    this.fadeUntil = now + this.renderer.fade;
    this.tellSorter({ type: "centers", first, centers }, [centers.buffer]);
  }

  private takeAttributes(pieces: readonly Attributes[], limit: number, serial: number, seconds: number): void {
    for (const piece of pieces) {
      this.renderer.setAttributes(piece);
      this.tellSorter({ type: "drawn", first: piece.first, drawn: piece.drawn, limit }, [piece.drawn.buffer]);
    }
    if (!pieces.length) this.tellSorter({ type: "drawn", first: 0, drawn: new Uint8Array(0), limit });
    this.limit = limit;
    this.decodeSeconds = seconds;
    this.shown = serial;
    this.sort();
    this.wake();
  }

  private sort(): void {
    if (this.sorting || !this.spare) {
      this.resort = true;
      return;
    }
    const row = this.pinhole().w2c.slice(8, 12);
    const { spare, shown } = this;
    this.sorting = true;
    this.resort = false;
    this.spare = null;
    this.tellSorter({ type: "sort", row, near: NEAR, serial: shown, spare }, [spare.buffer]);
  }

  private takeOrder({ order, count, serial }: Sorted): void {
    this.renderer.setOrder(order, count);
    this.spare = order;
    this.drawn = count;
    this.sorting = false;
    this.sortedFor = serial;
    if (this.resort) this.sort();
    this.wake();
  }

  private frame(now: number): void {
    this.handle = 0;
    const since = now - this.lastFrame;
    if (this.controls.active) {
      this.controls.step(Math.min(since, 100) / 1000);
      this.move();
    }
    this.guard(() => { this.paint(now, since); });
    const fading = this.seconds() < this.fadeUntil;
    if (this.needed || fading || !this.told || this.waiting.length) this.wake();
  }

  private lastFrame = 0;

  private paint(now: number, since: number): void {
    this.needed = false;
    const pinhole = this.pinhole();
    if (!this.told && now - this.toldAt >= VIEW_EVERY) this.tellView(false);
    if (now - this.moving < VIEW_EVERY) this.sort();
    this.renderer.draw(pinhole, this.seconds(), this.options.background);
    if (since > 0 && since < 1000) this.framesPerSecond += 0.1 * (1000 / since - this.framesPerSecond);
    this.lastFrame = now;
    if (this.baseWaits && !this.baseShown && this.drawn) {
      this.baseShown = true;
      this.events.base(this.seconds());
    }
    const settled = !this.resort && !this.sorting && this.seconds() >= this.fadeUntil;
    this.waiting = this.waiting.filter(({ serial, resolve }) => {
      if (!settled || this.sortedFor < serial) return true;
      resolve();
      return false;
    });
    this.events.frame();
  }
}
