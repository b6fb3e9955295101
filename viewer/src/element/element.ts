/** The element <gsynopsis-viewer src="scene.gsyn">. */

import type { Pinhole } from "../camera/camera";
import { asViewerError } from "../base/errors";
import type { ViewerError } from "../base/errors";
import type { ViewerBase, ViewerEvents } from "./element-events";
import type { ViewerLevel, ViewerStats } from "../ui/stats";
import type { SceneOptions, SceneEvents } from "../render/scene-options";
import { LazyModule } from "../base/lazy-module";
import type { Progress } from "../decode/messages";
import { LoadingView } from "../ui/poster";
import type { ViewerCamera } from "../camera/camera-api";
import { SceneView } from "../render/scene-view";
import { buildShell } from "../ui/shell";
import type { Shell } from "../ui/shell";
import type { Backend } from "../render/backend";
import type * as webgpu from "../render/webgpu/webgpu";
import type * as tools from "./tools";
import type { Host } from "./host";
import type { Tools } from "./tools";

/** All around the picture. */
export const toolsModule = new LazyModule<typeof tools>();
/** Another device than that of WebGL 2, for who asks for it. */
export const webgpuModule = new LazyModule<typeof webgpu>();
/** Splats that a device shows where nobody says otherwise. */
const BUDGET = 2_000_000;
const BUDGET_SMALL = 600_000;
/** The most for each GiB of memory that the browser tells of: about a tenth of it, see docs/results/viewer.md. */
const BUDGET_GIB = 500_000;
/** Pixels per CSS pixel, at most. */
const SHARPNESS_MAX = 2;
/** Attributes that cannot wait until the first picture is there. */
const AT_ONCE = ["live", "split", "level", "stats", "background"];

/** Elements of the page that have a graphics device; browsers give a page eight or sixteen. */
export const drawing = new Set<ViewerElement>();
const DRAWING_MAX = 6;

// Under node the module is there for its decoder alone.
const Base = ((globalThis as { HTMLElement?: typeof HTMLElement }).HTMLElement ?? Object) as unknown as {
  new (): ViewerBase;
  prototype: ViewerBase;
};

/** A scene on the page; attributes, methods and events are described in docs/viewer.md. */
export class ViewerElement extends Base {
  /** The scene on screen; what it can do is not promised to stay. */
  scene: SceneView | null = null;
  private stage: Shell | null = null;
  /** Buttons and panels, once their code is there. */
  tools: Tools | null = null;
  private equipped: Promise<Tools> | null = null;
  private progress: Progress = { bytes: 0, total: 0, rate: 0 };
  private readonly done: number[] = [];
  /** The file shown, to be opened again under other settings. */
  private opened: { source: string | Blob; name: string } | null = null;
  /** Message once the base is there. */
  private remark = "";
  private trouble = false;
  private readonly waiting = new LoadingView((text) => { if (!this.remark) this.say(text); });
  private ends = new AbortController();

  static readonly observedAttributes = ["src", "noui", "stats", "split", "level", "budget", "live", "background"];

  /** The camera. What is not given when it is set stays; `up` is that of the scene. */
  get camera(): ViewerCamera | null {
    return this.tools?.camera ?? null;
  }

  set camera(wanted: Partial<ViewerCamera> | null) {
    this.use((tools) => { tools.camera = wanted; });
  }

  /** The file's levels, coarsest first; none before its header is read. */
  get levels(): readonly ViewerLevel[] {
    return this.tools?.levels ?? [];
  }

  /** Figures of what is on screen. */
  get stats(): ViewerStats {
    return this.tools?.stats ?? { ...this.progress, splats: this.scene?.drawn ?? 0, fps: 0, decodeSeconds: 0 };
  }

  /** Go to the first view. */
  first(): void {
    this.use((tools) => { tools.first(); });
  }

  /** See all of the scene from the present direction. */
  whole(): void {
    this.use((tools) => { tools.places.whole(); });
  }

  /** Go to one of eight views around the scene: the next one, or so many further (or, below 0, back). */
  next(steps = 1): void {
    this.use((tools) => { tools.next(steps); });
  }

  /** Show or hide the list of keys and gestures. */
  help(): void {
    this.use((tools) => { tools.help(); });
  }

  /** The image on screen, as a PNG file of as many pixels. */
  async picture(): Promise<Blob> {
    return (await this.equip()).picture();
  }

  /** Show a file by address, or one that is at hand. */
  open(source: string | Blob, name = typeof source === "string" ? (source.split(/[?#]/)[0].split("/").pop() ?? "") : "file"): void {
    const address = typeof source === "string" ? new URL(source, document.baseURI).href : source;
    // What is on screen stays where this is no scene.
    if (this.scene?.facts) this.use((tools) => { tools.openChecked(address, name); });
    else this.show(address, name);
  }

  private show(address: string | Blob, name: string): void {
    const stage = (this.stage ??= this.build());
    this.opened = { source: address, name };
    if (!drawing.has(this) && drawing.size >= DRAWING_MAX) {
      this.use((tools) => { tools.crowd.queue(this, () => { this.show(address, name); }); });
      return;
    }
    drawing.add(this);
    this.scene?.close();
    this.trouble = false;
    stage.progress.hidden = false;
    this.remark = "";
    this.tools?.forget();
    this.waiting.begin();
    this.say("Loading…");
    const { opened } = this;
    if (this.getAttribute("renderer") === "webgpu") {
      webgpuModule.get().then(({ openBackend }) => openBackend()).then((backend) => {
        if (opened === this.opened && drawing.has(this)) this.begin(stage, address, name, backend);
      }).catch((error: unknown) => { this.fail(asViewerError(error)); });
    } else this.begin(stage, address, name);
  }

  private begin(stage: Shell, address: string | Blob, name: string, backend?: Backend): void {
    try {
      this.scene = new SceneView(stage.canvas, stage.stage, this.options(), this.sceneEvents(stage), backend);
      this.scene.divider = this.tools?.divider ?? this.scene.divider;
      this.resize();
      this.scene.open(address, name);
    } catch (error) {
      this.fail(asViewerError(error));
    }
  }

  /** Put there what is around the picture, which else comes after it. */
  equip(): Promise<Tools> {
    return (this.equipped ??= toolsModule.get().then((found) => this.take(found)));
  }

  /** The picture of a camera once all of it is decoded: RGBA8, for tests and tools. */
  async render(pinhole: Pinhole | null, level: number | null): Promise<{ width: number; height: number; pixels: Uint8ClampedArray }> {
    const scene = this.scene!;
    if (level !== null) scene.setLevel(level);
    scene.setPinhole(pinhole);
    await scene.settled();
    const { width, height, pixels } = scene.capture();
    scene.setPinhole(null);
    return { width, height, pixels: await pixels };
  }

  connectedCallback(): void {
    this.stage ??= this.build();
    if (toolsModule.now) this.take(toolsModule.now);
    this.ends = new AbortController();
    const { signal } = this.ends;
    this.tools?.attach(signal);
    const observer = new ResizeObserver(() => { this.resize(); });
    observer.observe(this);
    signal.addEventListener("abort", () => { observer.disconnect(); });
    document.addEventListener("keydown", (event) => {
      const late = !this.tools;
      this.use((tools) => { tools.pressKey(event, late); });
    }, { signal });
    this.attributeChangedCallback();
    // It was moved, or opened before it was here.
    if (this.scene) return;
    const src = this.getAttribute("src");
    if (this.opened) this.show(this.opened.source, this.opened.name);
    else if (src) this.openOrWatch(src);
  }

  disconnectedCallback(): void {
    this.ends.abort();
    queueMicrotask(() => {
      if (this.isConnected) return;
      this.tools?.close();
      this.scene?.close();
      this.scene = null;
      drawing.delete(this);
      this.tools?.crowd.look();
    });
  }

  attributeChangedCallback(name?: string, before?: string | null, now?: string | null): void {
    if (!this.stage) return;
    this.tools?.attribute(name);
    this.scene?.wake();
    if (AT_ONCE.some((each) => this.hasAttribute(each))) this.use(() => undefined);
    if (!name || before === now) return;
    if (name === "src") this.opened = null;
    if (!this.isConnected) return;
    if (name === "src" && now) this.openOrWatch(now);
    else if (name === "live") this.use((tools) => { tools.follow(); });
    else if (name === "budget") this.setBudget();
  }

  /** Call `use` with the tools: now if they are there, else as soon as they are. */
  private use(work: (tools: Tools) => void): void {
    if (this.tools) work(this.tools);
    else this.equip().then(work).catch((error: unknown) => { this.fail(asViewerError(error)); });
  }

  private take(found: { readonly Tools: new (host: Host, stage: Shell) => Tools }): Tools {
    if (!this.tools) {
      this.tools = new found.Tools(this.host(), (this.stage ??= this.build()));
      this.tools.attach(this.ends.signal);
      this.scene?.wake();
    }
    return this.tools;
  }

  private host(): Host {
    return {
      element: this,
      drawing,
      done: this.done,
      scene: () => this.scene,
      progress: () => this.progress,
      trouble: () => this.trouble,
      show: (source, name) => { this.show(source, name); },
      reopen: (source, name) => { this.reopen(source, name); },
      say: (text, fresh) => {
        if (fresh) this.trouble = false;
        this.say(text);
      },
      resize: () => { this.resize(); },
      fail: (error) => { this.fail(error); },
      tell: (error, kept) => { this.tell(error, kept); },
      emit: (name, detail) => { this.emit(name, detail); },
    };
  }

  private build(): Shell {
    return buildShell(this.attachShadow({ mode: "open", delegatesFocus: true }));
  }

  private openOrWatch(src: string): void {
    this.tools?.unwatch();
    if (this.hasAttribute("live")) this.use((tools) => { tools.follow(); });
    else this.open(src);
  }

  /** Go on to another version or another part of the file once it is decoded; the camera stays. */
  private reopen(source: string | Blob, name: string): void {
    this.opened = { source, name };
    this.scene?.replace(source, name).then((done) => { if (done) this.say(""); }, () => undefined);
  }

  private setBudget(): void {
    const { scene, opened } = this;
    if (!scene || !opened) return;
    scene.budget = this.options().budget;
    if (scene.facts) this.reopen(opened.source, opened.name);
    else this.open(opened.source, opened.name);
  }

  private sceneEvents({ canvas, progress: bar }: Shell): SceneEvents {
    return {
      header: (facts) => {
        this.tools?.header(facts);
        this.done.length = 0;
        this.waiting.show(canvas, facts);
        this.emit("header", { ...facts, levels: facts.levels.length });
      },
      progress: (progress) => {
        this.progress = progress;
        if (progress.total) bar.value = progress.bytes / progress.total;
        this.waiting.came(progress.bytes);
      },
      base: (seconds) => {
        this.waiting.end();
        this.say(this.remark);
        this.emit("base-ready", { bytes: this.done[0], seconds });
      },
      level: (level, bytes, seconds) => {
        this.done[level] = bytes;
        this.emit("level-ready", { level, bytes, seconds });
      },
      complete: (bytes, seconds) => {
        bar.hidden = true;
        this.use(() => { this.emit("complete", { bytes, seconds }); });
      },
      notice: (message) => {
        this.remark = message;
        this.say(message);
        this.emit("viewer-notice", { message });
      },
      error: (error) => { this.fail(error); },
      shown: () => { this.use(() => undefined); },
      frame: () => { this.tools?.frame(); },
    };
  }

  private options(): SceneOptions {
    const small = matchMedia("(pointer: coarse)").matches;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    // Only some browsers tell it, and of no more than 8 GiB or so.
    const { deviceMemory = 8 } = navigator as { deviceMemory?: number };
    const budget = Number(this.getAttribute("budget") ?? "") || Math.min(small ? BUDGET_SMALL : BUDGET, BUDGET_GIB * deviceMemory);
    return {
      budget, plain: this.hasAttribute("plain"), still, free: this.hasAttribute("free"), byLonger: small,
      takesWheel: (event) => event.ctrlKey || this.hasAttribute("wheel") || document.activeElement === this,
    };
  }

  private emit<Name extends keyof ViewerEvents>(name: Name, detail: ViewerEvents[Name]): void {
    this.dispatchEvent(new CustomEvent(name, { detail, bubbles: true, composed: true }));
  }

  private say(text: string, alert = false): void {
    const { note } = this.stage ?? {};
    if (!note || this.trouble) return;
    note.hidden = !text;
    note.textContent = text;
    note.classList.toggle("trouble", alert);
    note.role = alert ? "alert" : "status";
  }

  private fail(error: ViewerError): void {
    const { opened } = this;
    // Code that comes later finds out what it is instead.
    if (error.trouble === "NotGsynError" && opened) this.use((tools) => { tools.openChecked(opened.source, opened.name, error); });
    else this.tell(error);
  }

  /** Show an error; `kept`: the scene before is still there. */
  private tell(error: ViewerError, kept = false): void {
    console.error(`gsynopsis: ${error.message}`);
    this.say(error.message, true);
    this.trouble = !kept;
    if (!kept) this.tools?.failed();
    this.emit("viewer-error", { trouble: error.trouble, message: error.message });
    // Another file may be dropped here, or opened.
    this.equip().catch(() => undefined);
  }

  private resize(): void {
    const { stage, scene } = this;
    if (!stage) return;
    const sharpness = Math.min(devicePixelRatio || 1, SHARPNESS_MAX);
    stage.canvas.width = Math.max(1, Math.round(this.clientWidth * sharpness));
    stage.canvas.height = Math.max(1, Math.round(this.clientHeight * sharpness));
    scene?.move();
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "gsynopsis-viewer": ViewerElement;
  }
}

/** Make the element known, once. */
export function define(): void {
  if (!customElements.get("gsynopsis-viewer")) customElements.define("gsynopsis-viewer", ViewerElement);
}
