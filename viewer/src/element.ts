/** The element <gsynopsis-viewer src="scene.gsyn">. */

import type { Trouble, ViewerError } from "./errors";
import { asViewerError } from "./errors";
import type { Progress, SceneFacts } from "./messages";
import { SHORTCUTS, build } from "./page";
import type { ButtonName, Parts } from "./page";
import type { Pinhole } from "./renderer";
import { Scene } from "./scene";
import { Split } from "./split";
import { STATIONS } from "./viewpoints";
import { Watch } from "./watch";

/** Splats that a device shows where nobody says otherwise. */
const BUDGET = 2_000_000;
const BUDGET_SMALL = 600_000;
/** Pixels per CSS pixel, at most. */
const SHARPNESS_MAX = 2;
const MIB = 2 ** 20;
/** Seconds between two looks for a newer version, where `live` gives none. */
const LIVE_SECONDS = 2;
const NOT_YET = "There is nothing to show yet; this page looks again.";
const GONE = "The file cannot be reached any more; this is the last picture of it.";

// Under node the module is there for its decoder alone.
const Base = (globalThis as { HTMLElement?: typeof HTMLElement }).HTMLElement ?? (Object as unknown as typeof HTMLElement);

export class ViewerElement extends Base {
  scene: Scene | null = null;
  private parts: Parts | null = null;
  private progress: Progress = { bytes: 0, total: 0, rate: 0 };
  private readonly levels: number[] = [];
  private station = 0;
  /** Levels of the file shown, 0 before its header. */
  private known = 0;
  private split: Split | null = null;
  private watch: Watch | null = null;
  private told = "";
  /** What is said once the base is there. */
  private remark = "";
  private trouble = false;
  private observer: ResizeObserver | null = null;

  static readonly observedAttributes = ["src", "theme", "noui", "stats", "split"];

  connectedCallback(): void {
    if (!this.parts) {
      this.parts = build(this.attachShadow({ mode: "open" }));
      this.listen(this.parts);
      this.split = new Split(this.parts, {
        moved: (share) => {
          if (!this.scene) return;
          this.scene.divider = share;
          this.scene.wake();
        },
        chosen: (level) => { this.scene?.compare(level); },
      });
    }
    this.observer = new ResizeObserver(() => { this.resize(); });
    this.observer.observe(this);
    this.attributeChangedCallback();
    const src = this.getAttribute("src");
    if (src) this.openOrWatch(src);
  }

  disconnectedCallback(): void {
    this.watch?.close();
    this.watch = null;
    this.observer?.disconnect();
    this.scene?.close();
    this.scene = null;
  }

  attributeChangedCallback(name?: string, before?: string | null, now?: string | null): void {
    if (!this.parts) return;
    this.parts.bar.hidden = this.hasAttribute("noui");
    this.parts.facts.hidden = !this.hasAttribute("stats");
    if (name === "src" && now && before !== now && this.isConnected) this.openOrWatch(now);
    if (!name || name === "split") {
      const level = this.getAttribute("split");
      this.split?.toggle(level !== null, level ? Number(level) || 0 : undefined);
    }
  }

  /** With `live`, show each new version of the file as it comes, such as those of a training. */
  private openOrWatch(src: string): void {
    this.watch?.close();
    this.watch = null;
    if (!this.hasAttribute("live")) {
      this.open(src);
      return;
    }
    const address = new URL(src, document.baseURI);
    const name = address.pathname.split("/").pop() ?? "";
    this.watch = new Watch(address.href, {
      changed: (version) => {
        // An address of its own, so that no cache joins two versions.
        address.searchParams.set("version", version);
        if (!this.scene?.facts || this.trouble) this.open(address.href, name);
        else this.scene.replace(address.href, name).then((done) => { if (done) this.say(""); }, () => undefined);
      },
      missing: (known) => { this.say(known ? GONE : NOT_YET); },
      back: () => { this.say(""); },
    }, 1000 * (Number(this.getAttribute("live")) || LIVE_SECONDS));
  }

  /** Show a file by address, or one that is at hand. */
  open(source: string | Blob, name = typeof source === "string" ? (source.split(/[?#]/)[0].split("/").pop() ?? "") : "file"): void {
    const { parts } = this;
    if (!parts) return;
    this.scene?.close();
    this.trouble = false;
    parts.note.classList.remove("trouble");
    this.remark = "";
    this.known = 0;
    this.say("Loading…");
    const address = typeof source === "string" ? new URL(source, document.baseURI).href : source;
    try {
      const scene = new Scene(parts.canvas, parts.stage, this.options(), {
        header: (facts) => {
          this.setLevels(facts.most);
          this.levels.length = 0;
          this.emit("header", { ...facts, levels: facts.levels.length });
        },
        progress: (progress) => {
          this.progress = progress;
          if (progress.total) parts.progress.value = progress.bytes / progress.total;
        },
        base: (seconds) => {
          this.say(this.remark);
          this.emit("base-ready", { bytes: this.levels[0], seconds });
        },
        level: (level, bytes, seconds) => {
          this.levels[level] = bytes;
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
        frame: () => { this.showFacts(); },
      });
      this.scene = scene;
      scene.divider = this.split?.share ?? scene.divider;
      this.resize();
      scene.open(address, name);
    } catch (error) {
      this.fail(asViewerError(error));
    }
  }

  /** The picture of a camera once all of it is decoded: RGBA8, for tests and tools. */
  async picture(pinhole: Pinhole | null, level: number | null): Promise<{ width: number; height: number; pixels: Uint8ClampedArray }> {
    const scene = this.scene!;
    if (level !== null) scene.setLevel(level);
    scene.setPinhole(pinhole);
    await scene.settled();
    const found = scene.capture();
    scene.setPinhole(null);
    return found;
  }

  private options() {
    const small = matchMedia("(pointer: coarse)").matches;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const budget = Number(this.getAttribute("budget") ?? "") || (small ? BUDGET_SMALL : BUDGET);
    return { budget, plain: this.hasAttribute("plain"), background: [0, 0, 0], still, free: this.hasAttribute("free") };
  }

  private emit<Name extends keyof ViewerEvents>(name: Name, detail: ViewerEvents[Name]): void {
    for (const target of [this, window]) target.dispatchEvent(new CustomEvent(name, { detail }));
  }

  private say(text: string): void {
    const { parts } = this;
    if (!parts || this.trouble) return;
    parts.note.hidden = !text;
    parts.note.textContent = text;
  }

  private fail(error: ViewerError): void {
    console.error(`gsynopsis: ${error.message}`);
    this.say(error.message);
    this.parts?.note.classList.add("trouble");
    this.parts?.note.setAttribute("role", "alert");
    this.trouble = true;
    this.watch?.forget();
    this.emit("error", { trouble: error.trouble, message: error.message });
  }

  private resize(): void {
    const { parts, scene } = this;
    if (!parts) return;
    const sharpness = Math.min(devicePixelRatio || 1, SHARPNESS_MAX);
    parts.canvas.width = Math.max(1, Math.round(this.clientWidth * sharpness));
    parts.canvas.height = Math.max(1, Math.round(this.clientHeight * sharpness));
    scene?.move();
  }

  private setLevels(most: number): void {
    const { level } = this.parts!;
    const before = Number(level.value);
    const wanted = this.known ? String(before > this.known - 1 ? "auto" : before) : this.getAttribute("level");
    this.known = most + 1;
    level.min = "0";
    level.max = String(most + 1);
    const auto = wanted === null || wanted === "auto" || !Number.isInteger(Number(wanted));
    level.value = String(auto ? most + 1 : Math.min(most, Math.max(0, Number(wanted))));
    this.split?.setMost(most);
    this.chooseLevel();
  }

  private chooseLevel(): void {
    const { level, levelName } = this.parts!;
    const most = Number(level.max) - 1;
    const chosen = Number(level.value);
    const text = chosen > most ? "auto" : `L${chosen}`;
    levelName.textContent = text;
    level.setAttribute("aria-valuetext", text);
    this.split?.name(text);
    this.scene?.setLevel(Math.min(chosen, most));
  }

  private listen(parts: Parts): void {
    parts.level.addEventListener("input", () => { this.chooseLevel(); });
    for (const [name, button] of parts.buttons) button.addEventListener("click", () => { this.press(name); });
    parts.stage.addEventListener("keydown", (event) => {
      const name = SHORTCUTS.get(event.code);
      if (!name || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      this.press(name);
    });
    this.addEventListener("dragover", (event) => { event.preventDefault(); });
    this.addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file) this.open(file, file.name);
    });
  }

  private press(name: ButtonName): void {
    const { scene } = this;
    switch (name) {
      case "reset":
        scene?.visit((this.station = 0));
        break;
      case "fit":
        scene?.fit();
        break;
      case "before":
      case "after":
        this.station = (this.station + (name === "after" ? 1 : STATIONS - 1)) % STATIONS;
        scene?.visit(this.station / STATIONS);
        break;
      case "split":
        this.toggleAttribute("split");
        break;
      case "overlay":
        this.toggleAttribute("stats");
        scene?.wake();
        break;
      case "theme":
        this.setAttribute("theme", this.isLight() ? "dark" : "light");
        break;
      case "picture":
        this.savePicture().catch((error: unknown) => { this.fail(asViewerError(error)); });
        break;
      case "full":
        (document.fullscreenElement ? document.exitFullscreen() : this.requestFullscreen()).catch(() => {
          this.say("This browser does not allow full screen here.");
        });
        break;
    }
  }

  private isLight(): boolean {
    const theme = this.getAttribute("theme");
    return theme ? theme === "light" : matchMedia("(prefers-color-scheme: light)").matches;
  }

  private async savePicture(): Promise<void> {
    const found = this.scene?.capture(true);
    if (!found) return;
    const canvas = new OffscreenCanvas(found.width, found.height);
    const pixels = found.pixels as Uint8ClampedArray<ArrayBuffer>;
    canvas.getContext("2d")!.putImageData(new ImageData(pixels, found.width, found.height), 0, 0);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await canvas.convertToBlob());
    link.download = "scene.png";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  private showFacts(): void {
    const { scene, parts } = this;
    if (!scene?.facts || !parts || parts.facts.hidden) return;
    const { manifest, levels } = scene.facts;
    const quality = manifest?.quality ?? [];
    const lines = levels.map((level, k) => {
      const psnr = (quality.at(k) ?? {}).psnr_full as number | undefined;
      const figure = psnr === undefined ? "" : `  ${psnr.toFixed(2)} dB`;
      const mark = k in this.levels ? "✓" : " ";
      return `${mark} L${k}  ${(level.end / MIB).toFixed(2)} MiB${figure}`;
    });
    lines.push(
      `${(this.progress.bytes / MIB).toFixed(2)} MiB  ${(this.progress.rate / 1e6).toFixed(1)} Mbit/s`,
      `${scene.drawn.toLocaleString("en")} splats  ${scene.framesPerSecond.toFixed(0)} fps`,
      `decoded in ${(1000 * scene.decodeSeconds).toFixed(0)} ms`,
    );
    const text = lines.join("\n");
    if (text !== this.told) parts.facts.textContent = this.told = text;
  }
}

/** What its events carry in `detail`. */
export interface ViewerEvents {
  readonly header: Omit<SceneFacts, "levels"> & { readonly levels: number };
  readonly "base-ready": { readonly bytes: number; readonly seconds: number };
  readonly "level-ready": { readonly level: number; readonly bytes: number; readonly seconds: number };
  readonly complete: { readonly bytes: number; readonly seconds: number };
  readonly error: { readonly trouble: Trouble; readonly message: string };
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
