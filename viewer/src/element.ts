/** The element <gsynopsis-viewer src="scene.gsyn">. */

import { Bar } from "./bar";
import { asViewerError } from "./errors";
import type { ViewerError } from "./errors";
import type { ViewerBase, ViewerEvents } from "./events";
import { Frames, levelsOf, statsOf, textOf } from "./facts";
import type { ViewerLevel, ViewerStats } from "./facts";
import type { Options, SceneEvents } from "./host";
import { isOurs, shortcutOf } from "./keys";
import { LevelChoice } from "./level";
import { Live } from "./live";
import type { Progress } from "./messages";
import { build } from "./page";
import { Waiting } from "./poster";
import type { ButtonName, Parts } from "./page";
import { CameraNews, place, stateOf } from "./pose";
import type { ViewerCamera } from "./pose";
import type { Pinhole } from "./renderer";
import { Scene } from "./scene";
import { Split } from "./split";
import { STATIONS } from "./viewpoints";

/** Splats that a device shows where nobody says otherwise. */
const BUDGET = 2_000_000;
const BUDGET_SMALL = 600_000;
/** Pixels per CSS pixel, at most. */
const SHARPNESS_MAX = 2;

// Under node the module is there for its decoder alone.
const Base = ((globalThis as { HTMLElement?: typeof HTMLElement }).HTMLElement ?? Object) as unknown as {
  new (): ViewerBase;
  prototype: ViewerBase;
};

/** A scene on the page; attributes, methods and events are described in docs/viewer.md. */
export class ViewerElement extends Base {
  /** The scene on screen; what it can do is not promised to stay. */
  scene: Scene | null = null;
  private parts: Parts | null = null;
  private progress: Progress = { bytes: 0, total: 0, rate: 0 };
  private readonly frames = new Frames();
  private readonly done: number[] = [];
  private station = 0;
  /** What is shown, to be opened again under other settings. */
  private opened: { source: string | Blob; name: string } | null = null;
  private split: Split | null = null;
  private choice: LevelChoice | null = null;
  private bar: Bar | null = null;
  private live: Live | null = null;
  private told = "";
  /** What is said once the base is there. */
  private remark = "";
  private trouble = false;
  private over = false;
  private readonly waiting = new Waiting((text) => { if (!this.remark) this.say(text); });
  private ends = new AbortController();
  private readonly news = new CameraNews((state) => { this.emit("camera-change", state); });

  static readonly observedAttributes = ["src", "noui", "stats", "split", "level", "budget", "live"];

  /** The camera. What is not given when it is set stays; `up` is that of the scene. */
  get camera(): ViewerCamera | null {
    return this.scene?.facts ? stateOf(this.scene.camera) : null;
  }

  set camera(wanted: Partial<ViewerCamera> | null) {
    if (!wanted || !this.scene?.facts) return;
    place(this.scene.camera, wanted);
    this.scene.move();
  }

  /** The file's levels, coarsest first; none before its header is read. */
  get levels(): readonly ViewerLevel[] {
    return this.scene?.facts ? levelsOf(this.scene.facts, this.done) : [];
  }

  /** Figures of what is on screen. */
  get stats(): ViewerStats {
    return statsOf(this.scene, this.progress, this.frames);
  }

  /** Go to the first view. */
  first(): void {
    this.scene?.visit((this.station = 0));
  }

  /** See all of the scene from the present direction. */
  whole(): void {
    this.scene?.fit();
  }

  /** Go to one of eight views around the scene: the next one, or so many further (or, below 0, back). */
  next(steps = 1): void {
    this.station = (((this.station + steps) % STATIONS) + STATIONS) % STATIONS;
    this.scene?.visit(this.station / STATIONS);
  }

  /** Show or hide the list of keys and gestures. */
  help(): void {
    this.bar?.help();
  }

  /** What is on screen, as a PNG file of as many pixels. */
  async picture(): Promise<Blob> {
    const { scene } = this;
    if (!scene?.facts) throw new Error("picture: there is no scene yet");
    const { width, height, pixels } = scene.capture(true);
    const canvas = new OffscreenCanvas(width, height);
    canvas.getContext("2d")!.putImageData(new ImageData(pixels as Uint8ClampedArray<ArrayBuffer>, width, height), 0, 0);
    return canvas.convertToBlob({ type: "image/png" });
  }

  /** Show a file by address, or one that is at hand. */
  open(source: string | Blob, name = typeof source === "string" ? (source.split(/[?#]/)[0].split("/").pop() ?? "") : "file"): void {
    const { parts } = this;
    if (!parts) return;
    this.scene?.close();
    this.trouble = false;
    parts.note.classList.remove("trouble");
    parts.note.setAttribute("role", "status");
    parts.progress.hidden = false;
    this.remark = "";
    this.choice?.forget();
    this.waiting.begin();
    this.say("Loading…");
    const address = typeof source === "string" ? new URL(source, document.baseURI).href : source;
    this.opened = { source: address, name };
    try {
      this.scene = new Scene(parts.canvas, parts.stage, this.options(), this.sceneEvents(parts));
      this.scene.divider = this.split?.share ?? this.scene.divider;
      this.resize();
      this.scene.open(address, name);
    } catch (error) {
      this.fail(asViewerError(error));
    }
  }

  /** The picture of a camera once all of it is decoded: RGBA8, for tests and tools. */
  async render(pinhole: Pinhole | null, level: number | null): Promise<{ width: number; height: number; pixels: Uint8ClampedArray }> {
    const scene = this.scene!;
    if (level !== null) scene.setLevel(level);
    scene.setPinhole(pinhole);
    await scene.settled();
    const found = scene.capture();
    scene.setPinhole(null);
    return found;
  }

  connectedCallback(): void {
    this.parts ??= this.build();
    this.ends = new AbortController();
    const { signal } = this.ends;
    const observer = new ResizeObserver(() => { this.resize(); });
    observer.observe(this);
    signal.addEventListener("abort", () => { observer.disconnect(); });
    document.addEventListener("keydown", (event) => { this.pressKey(event); }, { signal });
    this.attributeChangedCallback();
    const src = this.getAttribute("src");
    if (src) this.openOrWatch(src);
  }

  disconnectedCallback(): void {
    this.ends.abort();
    this.unwatch();
    this.news.close();
    this.scene?.close();
    this.scene = null;
  }

  attributeChangedCallback(name?: string, before?: string | null, now?: string | null): void {
    if (!this.parts) return;
    this.parts.bar.hidden = this.hasAttribute("noui");
    this.parts.facts.hidden = !this.hasAttribute("stats");
    this.scene?.wake();
    if (!name || name === "split") {
      const level = this.getAttribute("split");
      this.split?.toggle(level !== null, level ? Number(level) || 0 : undefined);
    }
    if (!this.isConnected || before === now) return;
    if (name === "src" && now) this.openOrWatch(now);
    else if (name === "live") this.follow();
    else if (name === "level") this.choice?.choose(now ?? null);
    else if (name === "budget") this.setBudget();
  }

  private build(): Parts {
    const parts = build(this.attachShadow({ mode: "open", delegatesFocus: true }));
    this.choice = new LevelChoice(parts, (level, text) => {
      this.split?.name(text);
      this.scene?.setLevel(level);
    });
    for (const [name, button] of parts.buttons) button.addEventListener("click", () => { this.press(name); });
    this.addEventListener("dragover", (event) => { event.preventDefault(); });
    this.addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file) this.open(file, file.name);
    });
    this.addEventListener("pointerenter", () => { this.over = true; });
    this.addEventListener("pointerleave", () => { this.over = false; });
    this.bar = new Bar(parts);
    this.split = new Split(parts, {
      moved: (share) => {
        if (!this.scene) return;
        this.scene.divider = share;
        this.scene.wake();
      },
      chosen: (level) => { this.scene?.compare(level); },
    });
    return parts;
  }

  private openOrWatch(src: string): void {
    this.unwatch();
    if (this.hasAttribute("live")) this.follow();
    else this.open(src);
  }

  private unwatch(): void {
    this.live?.close();
    this.live = null;
  }

  /** With `live`, show each new version of the file as it comes, such as those of a training. */
  private follow(): void {
    const version = this.live?.version;
    this.unwatch();
    const src = this.getAttribute("src");
    if (!this.hasAttribute("live") || !src) return;
    this.live = new Live(new URL(src, document.baseURI), this.parts!.training, {
      open: (address, name) => {
        if (!this.scene?.facts || this.trouble) this.open(address, name);
        else this.reopen(address, name);
      },
      say: (text) => { this.say(text); },
      shown: () => this.scene?.facts?.levels.at(-1)?.end ?? 0,
    }, Number(this.getAttribute("live")), version);
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

  private sceneEvents(parts: Parts): SceneEvents {
    return {
      header: (facts) => {
        this.split?.setMost(facts.most);
        this.choice?.setMost(facts.most, this.getAttribute("level"));
        this.done.length = 0;
        this.waiting.show(parts.canvas, facts);
        this.emit("header", { ...facts, levels: facts.levels.length });
      },
      progress: (progress) => {
        this.progress = progress;
        if (progress.total) parts.progress.value = progress.bytes / progress.total;
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
        parts.progress.hidden = true;
        this.emit("complete", { bytes, seconds });
      },
      notice: (text) => {
        this.remark = text;
        this.say(text);
      },
      error: (error) => { this.fail(error); },
      frame: () => {
        this.frames.add();
        this.showFacts();
        if (this.scene?.facts) this.news.look(this.scene.camera);
      },
    };
  }

  private options(): Options {
    const small = matchMedia("(pointer: coarse)").matches;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const budget = Number(this.getAttribute("budget") ?? "") || (small ? BUDGET_SMALL : BUDGET);
    return {
      budget, plain: this.hasAttribute("plain"), background: [0, 0, 0], still, free: this.hasAttribute("free"),
      takesWheel: (event) => event.ctrlKey || this.hasAttribute("wheel") || document.activeElement === this,
    };
  }

  private emit<Name extends keyof ViewerEvents>(name: Name, detail: ViewerEvents[Name]): void {
    this.dispatchEvent(new CustomEvent(name, { detail, bubbles: true, composed: true }));
  }

  private say(text: string): void {
    const { note } = this.parts ?? {};
    if (!note || this.trouble) return;
    note.hidden = !text;
    note.textContent = text;
  }

  private fail(error: ViewerError): void {
    console.error(`gsynopsis: ${error.message}`);
    this.say(error.message);
    this.parts?.note.classList.add("trouble");
    this.parts?.note.setAttribute("role", "alert");
    this.trouble = true;
    this.live?.forget();
    this.emit("viewer-error", { trouble: error.trouble, message: error.message });
  }

  private resize(): void {
    const { parts, scene } = this;
    if (!parts) return;
    const sharpness = Math.min(devicePixelRatio || 1, SHARPNESS_MAX);
    parts.canvas.width = Math.max(1, Math.round(this.clientWidth * sharpness));
    parts.canvas.height = Math.max(1, Math.round(this.clientHeight * sharpness));
    scene?.move();
  }

  private pressKey(event: KeyboardEvent): void {
    if (!isOurs(event, this, this.over)) return;
    const name = shortcutOf(event);
    if (name) this.press(name);
    else if (!(event.key === "Escape" && this.bar?.close()) && !this.scene?.controls.press(event)) return;
    event.preventDefault();
  }

  private press(name: ButtonName): void {
    const actions: Record<ButtonName, () => void> = {
      reset: () => { this.first(); },
      fit: () => { this.whole(); },
      before: () => { this.next(-1); },
      after: () => { this.next(); },
      split: () => { this.toggleAttribute("split"); },
      overlay: () => { this.toggleAttribute("stats"); },
      theme: () => { this.setAttribute("theme", this.isLight() ? "dark" : "light"); },
      picture: () => { this.savePicture().catch((error: unknown) => { this.fail(asViewerError(error)); }); },
      full: () => {
        const change = document.fullscreenElement ? document.exitFullscreen() : this.requestFullscreen();
        change.catch(() => { this.say("This browser does not allow full screen here."); });
      },
      help: () => { this.help(); },
    };
    actions[name]();
  }

  private isLight(): boolean {
    const theme = this.getAttribute("theme");
    return theme ? theme === "light" : matchMedia("(prefers-color-scheme: light)").matches;
  }

  private async savePicture(): Promise<void> {
    if (!this.scene?.facts) return;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await this.picture());
    link.download = "scene.png";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  private showFacts(): void {
    const { scene, parts } = this;
    if (!scene?.facts || !parts || parts.facts.hidden) return;
    const text = textOf(this.levels, this.stats);
    if (text !== this.told) parts.facts.textContent = this.told = text;
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
