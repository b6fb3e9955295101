/** Annotations on the picture: numbered dots, a card with the text of one of them, and fields to write it. */

import { dot } from "../base/vec3";
import type { Vec } from "../base/vec3";
import { poseOf } from "../camera/camera";
import type { Pinhole } from "../camera/camera";
import type { Annotation } from "../format/notes/annotations";
import { ANNOTATIONS_MAX, TEXT_MAX, TITLE_MAX } from "../format/notes/annotations";
import { icon } from "./icons";
import { appendElement } from "./shell";
import type { Toolbar } from "./toolbar";
import { translated } from "./words";

export interface AnnotationEvents {
  /** Go to where one is seen from. */
  visit(camera: Annotation["camera"]): void;
  /** Keep all of them; the message for people. */
  save(all: readonly Annotation[]): Promise<string>;
  say(text: string): void;
  /** There are other ones: the next frame places their dots. */
  changed(): void;
}

export class Annotations {
  private list: Annotation[] = [];
  private dots: HTMLButtonElement[] = [];
  private readonly layer: HTMLElement;
  private readonly card: HTMLElement;
  /** Number of the one whose card is open, -1 for none. */
  private shown = -1;
  /** Cards have fields to write into. */
  private editing = false;

  constructor(private readonly parts: Toolbar, private readonly events: AnnotationEvents) {
    this.layer = document.createElement("div");
    this.layer.className = "dots";
    parts.divider.after(this.layer);
    this.card = document.createElement("section");
    this.card.className = "panel card";
    this.card.hidden = true;
    this.layer.after(this.card);
    this.card.addEventListener("keydown", (event) => { if (event.key === "Escape") this.close(); });
  }

  /** Show those of another file. */
  show(list: readonly Annotation[]): void {
    this.list = [...list];
    this.editing = false;
    this.close();
    this.build();
  }

  hide(hidden: boolean): void {
    this.layer.hidden = hidden;
  }

  /** Place the dots for a picture of a camera. */
  place({ w2c, fx, fy, cx, cy, width, height }: Pinhole): void {
    if (!this.dots.length) return;
    const { position, right, down, forward } = poseOf(w2c, 1);
    this.list.forEach(({ at }, k) => {
      const away = at.map((value, axis) => value - position[axis]) as Vec;
      const depth = dot(away, forward);
      const { style } = this.dots[k];
      const [x, y] = [(cx + (fx * dot(away, right)) / depth) / width, (cy + (fy * dot(away, down)) / depth) / height];
      style.visibility = depth > 0 && x > 0 && x < 1 && y > 0 && y < 1 ? "visible" : "hidden";
      style.left = `${100 * x}%`;
      style.top = `${100 * y}%`;
    });
  }

  /** Their places in the world; none while nobody sees them. */
  get places(): readonly Vec[] {
    return this.layer.hidden ? [] : this.list.map(({ at }) => at);
  }

  /** Fade the dot of one that is behind something. */
  fade(number: number, behind: boolean): void {
    this.dots[number]?.classList.toggle("behind", behind);
  }

  /** Go to the next one, or back with -1: a tour. */
  step(steps: number): void {
    const { length } = this.list;
    if (length) this.open((((this.shown < 0 && steps < 0 ? 0 : this.shown) + steps) % length + length) % length);
  }

  /** Write a new one at a place, seen as now. */
  add(at: Vec, camera: Annotation["camera"]): void {
    if (this.list.length === ANNOTATIONS_MAX) {
      this.events.say(translated("There is no room for more notes."));
      return;
    }
    this.editing = true;
    this.list.push({ title: "", text: "", at, camera });
    this.build();
    this.fill(this.list.length - 1);
    this.card.querySelector("input")?.focus();
  }

  /** Close the card; false if none was open. */
  close(): boolean {
    if (this.card.hidden) return false;
    this.card.hidden = true;
    this.dots[this.shown]?.removeAttribute("aria-current");
    this.shown = -1;
    return true;
  }

  private open(number: number): void {
    this.fill(number);
    this.events.visit(this.list[number].camera);
  }

  private build(): void {
    this.layer.replaceChildren();
    this.dots = this.list.map(({ title }, k) => {
      const button = appendElement("button", "dot", this.layer);
      button.type = "button";
      button.textContent = String(k + 1);
      button.setAttribute("aria-label", `${k + 1}: ${title}`);
      button.style.visibility = "hidden";
      button.addEventListener("click", () => { this.open(k); });
      return button;
    });
    const tour = this.parts.buttons.get("tour");
    if (tour) tour.hidden = !this.list.length;
    this.events.changed();
  }

  private fill(number: number): void {
    this.close();
    const { card } = this;
    this.shown = number;
    const { title, text } = this.list[number];
    this.dots[number].setAttribute("aria-current", "true");
    card.replaceChildren();
    card.hidden = false;
    const header = appendElement("header", "", card);
    appendElement("b", "", header).textContent = `${number + 1} / ${this.list.length}`;
    const button = (name: "before" | "after" | "close", label: string, work: () => void) => {
      const made = appendElement("button", "", header);
      made.type = "button";
      made.innerHTML = icon(name);
      made.setAttribute("aria-label", translated(label));
      made.addEventListener("click", work);
    };
    button("before", "Note before", () => { this.step(-1); });
    button("after", "Next note", () => { this.step(1); });
    button("close", "Close", () => { this.close(); });
    if (this.editing) this.fields(number);
    else {
      appendElement("h3", "", card).textContent = title;
      appendElement("p", "", card).textContent = text;
    }
  }

  private fields(number: number): void {
    const { card, list } = this;
    const { title, text } = list[number];
    const name = appendElement("input", "", card);
    name.maxLength = TITLE_MAX;
    name.value = title;
    name.placeholder = name.ariaLabel = translated("Title");
    const area = appendElement("textarea", "", card);
    area.maxLength = TEXT_MAX;
    area.rows = 3;
    area.value = text;
    area.placeholder = area.ariaLabel = translated("Text");
    const keep = () => {
      list[number] = { ...list[number], title: name.value, text: area.value };
      this.dots[number].setAttribute("aria-label", `${number + 1}: ${name.value}`);
    };
    name.addEventListener("input", keep);
    area.addEventListener("input", keep);
    const row = appendElement("footer", "", card);
    const button = (label: string, work: () => void) => {
      const made = appendElement("button", "", row);
      made.type = "button";
      made.textContent = translated(label);
      made.addEventListener("click", work);
    };
    button("Delete", () => {
      list.splice(number, 1);
      this.close();
      this.build();
    });
    button("Save all", () => {
      this.events.save(list).then((text) => {
        this.editing = false;
        this.close();
        this.events.say(text);
      }, (error: unknown) => { this.events.say(error instanceof Error ? error.message : String(error)); });
    });
  }
}
