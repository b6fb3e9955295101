/** Interaction beyond the camera: buttons, keys, levels side by side, a file that changes. */

import { Menu } from "../ui/menu";
import { asViewerError } from "../base/errors";
import type { ViewerError } from "../base/errors";
import { Supersampling } from "../render/supersampling";
import { pictureOf } from "./picture";
import { FrameCounter, levelsOf, statsOf, statsText } from "../ui/stats";
import type { ViewerLevel, ViewerStats } from "../ui/stats";
import { isForViewer, shortcutOf } from "../ui/shortcuts";
import type { Host } from "./host";
import { Places } from "./places";
import { sceneOf } from "./file-check";
import { annotationsOf } from "../format/notes/annotations";
import { Notes, download } from "./notes";
import { offerHeadset, toggleHeadset } from "./headset";
import { OnFoot } from "./on-foot";
import { Presence } from "../ui/presence";
import { speak, translated } from "../ui/words";
import { KeyMoves } from "../camera/key-moves";
import { Crowd } from "./crowd";
import { LevelSlider } from "../ui/level-slider";
import { LiveReload } from "../ui/live/reload";
import type { SceneFacts } from "../decode/messages";
import { buildToolbar } from "../ui/toolbar";
import type { ButtonName } from "../ui/shortcuts";
import type { Toolbar } from "../ui/toolbar";
import { CameraChanges, placeCamera, cameraState } from "../camera/camera-api";
import type { ViewerCamera } from "../camera/camera-api";
import { SplitView } from "../ui/split-view";
import type { Shell } from "../ui/shell";
import { STATIONS } from "../camera/viewpoints";

/** Widths in which the bar has room for few buttons, pixels; as in ui/style.ts. */
const NARROW = 640;
/** Milliseconds for which an error is shown over a scene that stays. */
const READING = 10_000;

export class Tools {
  /** Share of the width that the other level takes. */
  get divider(): number {
    return this.split.share;
  }

  readonly places: Places;
  readonly crowd: Crowd;
  private readonly parts: Toolbar;
  private readonly frames = new FrameCounter();
  readonly finer = new Supersampling();
  private readonly choice: LevelSlider;
  private readonly bar: Menu;
  private readonly split: SplitView;
  private readonly news: CameraChanges;
  private live: LiveReload | null = null;
  private readonly notes: Notes;
  private readonly keys = new KeyMoves();
  private readonly feet: OnFoot;
  private readonly presence: Presence;
  /** Last place of the pointer, as a share of the picture's width and height. */
  private pointer: [number, number] = [0.5, 0.5];
  private station = 0;
  /** Ends when another file is asked for. */
  private asked = new AbortController();
  private reader = 0;
  private told = "";
  private over: boolean;

  constructor(private readonly host: Host, stage: Shell) {
    const { element } = host;
    speak(element.lang ? [element.lang] : navigator.languages);
    this.parts = buildToolbar(stage);
    this.places = new Places(() => host.scene(), () => host.done.length);
    const { parts } = this;
    this.choice = new LevelSlider(parts, (level, text) => {
      this.split.name(text);
      host.scene()?.setLevel(level);
    });
    for (const [name, button] of parts.buttons) button.addEventListener("click", () => { this.press(name); });
    this.crowd = new Crowd(host.drawing);
    const finished = () => { this.crowd.finished(element); };
    element.addEventListener("viewer-error", finished);
    element.addEventListener("complete", () => { host.scene()?.settled().then(finished, finished); });
    for (const name of ["pointerenter", "focusin"]) element.addEventListener(name, () => { this.crowd.wake(element); });
    this.over = element.matches(":hover");
    element.addEventListener("pointerenter", () => { this.over = true; });
    element.addEventListener("pointerleave", () => { this.over = false; });
    element.addEventListener("dragover", (event) => { event.preventDefault(); });
    element.addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file) this.openChecked(file, file.name);
    });
    this.presence = new Presence(parts);
    this.watch(stage.stage);
    this.bar = new Menu(parts);
    this.notes = new Notes(host, parts, this.places, (text) => { this.tell(text); });
    parts.buttons.get("tour")!.hidden = true;
    offerHeadset(parts.buttons.get("headset")!);
    this.feet = new OnFoot(host, this.places, this.keys, parts.buttons.get("walk")!, (text) => { this.tell(text); });
    this.split = new SplitView(parts, {
      moved: (share) => {
        const scene = host.scene();
        if (!scene) return;
        scene.divider = share;
        scene.wake();
      },
      chosen: (level) => { host.scene()?.compare(level); },
    });
    this.news = new CameraChanges((state) => { host.emit("camera-change", state); });
    this.attribute();
    // The scene may be there already.
    const facts = host.scene()?.facts;
    if (facts) this.header(facts);
  }

  /** Gestures beyond those of the first script. */
  private watch(surface: HTMLElement): void {
    const { places } = this;
    const placeOf = ({ clientX, clientY }: MouseEvent): [number, number] => {
      const { left, top, width, height } = surface.getBoundingClientRect();
      return [(clientX - left) / width, (clientY - top) / height];
    };
    surface.addEventListener("pointermove", (event) => { this.pointer = placeOf(event); });
    surface.addEventListener("pointerdown", (event) => {
      this.pointer = placeOf(event);
      // The frame of the focus is for those who move by keys.
      surface.classList.add("mouse");
      this.stop();
    });
    surface.addEventListener("blur", () => { surface.classList.remove("mouse"); });
    surface.addEventListener("wheel", () => {
      this.stop();
      places.guard();
    }, { capture: true, passive: true });
    surface.addEventListener("pointermove", ({ isPrimary }) => { if (!isPrimary) places.guard(); }, { capture: true });
    surface.addEventListener("dblclick", (event) => { places.lookAt(...placeOf(event)); });
  }

  /** The camera is somebody's again. */
  private stop(): void {
    const scene = this.host.scene();
    if (scene && scene.mover !== this.keys) scene.mover = null;
  }

  /** Listen beyond the element, until the signal. */
  attach(signal: AbortSignal): void {
    this.keys.listen(signal);
    const observer = new ResizeObserver(() => {
      this.arrange();
      this.host.resize();
    });
    // Of device pixels where the browser has such a box: a zoom changes them alone.
    try {
      observer.observe(this.parts.stage, { box: "device-pixel-content-box" });
    } catch {
      observer.observe(this.parts.stage);
    }
    signal.addEventListener("abort", () => { observer.disconnect(); });
    const watch = () => {
      matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => {
        this.host.resize();
        watch();
      }, { once: true, signal });
    };
    watch();
  }

  /**
   * Show a file if it is a scene, or our own server makes one of it; else say what it is, and what is on screen stays.
   * `error`: why it could not be shown as it is.
   */
  openChecked(source: string | Blob, name: string, error?: ViewerError): void {
    const { host } = this;
    this.asked.abort();
    const { signal } = (this.asked = new AbortController());
    const begin = () => {
      clearTimeout(this.reader);
      host.say(translated("Importing…"), true);
      return signal;
    };
    sceneOf(source, name, host.element.hasAttribute("import") ? begin : null).then((scene) => {
      if (error && scene === source) throw error;
      if (!signal.aborted) host.show(scene, name);
    }).catch((refusal: unknown) => {
      if (signal.aborted) return;
      if (error || !host.scene()?.facts) host.tell(asViewerError(refusal));
      else this.refuse(asViewerError(refusal));
    });
  }

  get camera(): ViewerCamera | null {
    const scene = this.host.scene();
    return scene?.facts ? cameraState(scene.camera) : null;
  }

  set camera(wanted: Partial<ViewerCamera> | null) {
    const scene = this.host.scene();
    if (!wanted || !scene?.facts) return;
    placeCamera(scene.camera, wanted);
    scene.move();
  }

  get levels(): readonly ViewerLevel[] {
    const { done } = this.host;
    const scene = this.host.scene();
    return scene?.facts ? levelsOf(scene.facts, done) : [];
  }

  get stats(): ViewerStats {
    return statsOf(this.host.scene(), this.host.progress(), this.frames);
  }

  first(): void {
    this.stop();
    this.host.scene()?.visit((this.station = 0));
  }

  next(steps: number): void {
    this.stop();
    this.station = (((this.station + steps) % STATIONS) + STATIONS) % STATIONS;
    this.host.scene()?.visit(this.station / STATIONS);
  }

  help(): void {
    this.bar.help();
  }

  async picture(): Promise<Blob> {
    const scene = this.host.scene();
    if (!scene?.facts) throw new Error("picture: there is no scene yet");
    return pictureOf(scene, [this.parts.room, this.host.element]);
  }

  /** An attribute of the element is another one; without a name all of them. */
  attribute(name?: string): void {
    const { element } = this.host;
    this.parts.bar.hidden = element.hasAttribute("noui");
    this.parts.facts.hidden = !element.hasAttribute("stats");
    if (!name || name === "background") this.parts.room.style.background = element.getAttribute("background") ?? "";
    this.presence.shown = !element.hasAttribute("noui");
    this.notes.cards.hide(element.hasAttribute("noui"));
    if (!name || name === "split") {
      const level = element.getAttribute("split");
      this.split.toggle(level !== null, level ? Number(level) || 0 : undefined);
    }
    this.arrange();
    if (name === "level") this.choice.choose(element.getAttribute("level"));
  }

  /** Another file is opened. */
  forget(): void {
    clearTimeout(this.reader);
    this.asked.abort();
    this.feet.end();
    this.choice.forget();
  }

  header(facts: SceneFacts): void {
    this.split.setMost(facts.most);
    this.choice.setMost(facts.most, this.host.element.getAttribute("level"));
    this.notes.cards.show(annotationsOf(facts.manifest));
  }

  frame(): void {
    this.frames.add();
    this.showFacts();
    const scene = this.host.scene();
    if (!scene?.facts || scene.painter) return;
    this.finer.frame(scene);
    this.presence.frame(scene.drawn > 0);
    this.notes.frame(scene);
    this.news.look(scene.camera);
  }

  /** Show each new version of the file as it comes, such as those of a training (`live`). */
  follow(): void {
    const { host } = this;
    const { element } = host;
    const version = this.live?.version;
    this.unwatch();
    const src = element.getAttribute("src");
    if (!element.hasAttribute("live") || !src) return;
    this.live = new LiveReload(new URL(src, document.baseURI), this.parts.training, {
      open: (address, name) => {
        if (!host.scene()?.facts || host.trouble()) host.show(address, name);
        else host.reopen(address, name);
      },
      say: (text) => { host.say(text); },
      shown: () => host.scene()?.facts?.levels.at(-1)?.end ?? 0,
    }, Number(element.getAttribute("live")), version);
  }

  unwatch(): void {
    this.live?.close();
    this.live = null;
  }

  /** The file could not be shown. */
  failed(): void {
    this.live?.forget();
  }

  close(): void {
    this.asked.abort();
    this.unwatch();
    this.finer.close();
    this.notes.close();
    this.news.close();
  }

  /** A key went down; `late`: some time ago, so that it may be up again. */
  pressKey(event: KeyboardEvent, late: boolean): void {
    if (!isForViewer(event, this.host.element, this.over)) return;
    this.presence.wake();
    this.presence.forget();
    const name = shortcutOf(event);
    if (name) this.press(name);
    else if (event.code === "KeyM") this.notes.add(...this.pointer);
    else if (late) return;
    else if (!(event.key === "Escape" && (this.bar.close() || this.notes.cards.close() || this.feet.end())) && !this.move(event)) return;
    event.preventDefault();
  }

  /** Hold a key that moves the camera. */
  private move(event: KeyboardEvent): boolean {
    const scene = this.host.scene();
    if (!scene || !this.keys.press(event)) return false;
    scene.mover = this.keys;
    if (["Equal", "NumpadAdd"].includes(event.code)) this.places.guard();
    scene.move();
    return true;
  }

  /** Say for a while, beside the scene that is shown, why another file cannot be. */
  private refuse(error: ViewerError): void {
    this.host.tell(error, true);
    this.hush();
  }

  /** Say something for a while. */
  private tell(text: string): void {
    this.host.say(text);
    this.hush();
  }

  private hush(): void {
    const { host } = this;
    clearTimeout(this.reader);
    this.reader = window.setTimeout(() => { if (!host.trouble()) host.say(""); }, READING);
  }

  private press(name: ButtonName): void {
    const { host, parts, places } = this;
    const { element } = host;
    const actions: Record<ButtonName, () => void> = {
      reset: () => { this.first(); },
      fit: () => { places.whole(); },
      tour: () => { this.notes.cards.step(1); },
      before: () => { this.next(-1); },
      after: () => { this.next(1); },
      walk: () => { this.feet.toggle(); },
      split: () => { element.toggleAttribute("split"); },
      overlay: () => { element.toggleAttribute("stats"); },
      theme: () => { element.setAttribute("theme", this.isLight() ? "dark" : "light"); },
      picture: () => { this.savePicture().catch((error: unknown) => { host.fail(asViewerError(error)); }); },
      full: () => {
        const change = document.fullscreenElement ? document.exitFullscreen() : element.requestFullscreen();
        change.catch(() => { host.say("This browser does not allow full screen here."); });
      },
      headset: () => { toggleHeadset(host, places).catch((error: unknown) => { this.tell(`The headset did not start: ${asViewerError(error).message}`); }); },
      help: () => { this.help(); },
    };
    if (!parts.buttons.get(name)!.hidden) actions[name]();
  }

  private isLight(): boolean {
    const theme = this.host.element.getAttribute("theme");
    return theme ? theme === "light" : matchMedia("(prefers-color-scheme: light)").matches;
  }

  private async savePicture(): Promise<void> {
    if (!this.host.scene()?.facts) return;
    download(await this.picture(), "scene.png");
  }

  /** Put the slider of levels into the menu where the bar is narrow. */
  private arrange(): void {
    const { bar, more, level } = this.parts;
    const label = level.parentElement!;
    if (this.host.element.clientWidth < NARROW && !bar.classList.contains("split")) more.prepend(label);
    else more.before(label);
  }

  private showFacts(): void {
    const { parts } = this;
    if (!this.host.scene()?.facts || parts.facts.hidden) return;
    const text = statsText(this.levels, this.stats);
    if (text !== this.told) parts.facts.textContent = this.told = text;
  }
}
