/** What is around the picture. */

import { icon } from "./icons";
import { HELP, SUMMARY } from "./shortcuts";
import { make } from "./shell";
import type { Stage } from "./shell";
import { STYLE } from "./style";

/** Buttons: what they are called, and the key that does the same. */
export const BUTTONS = [
  ["before", "View before", "["],
  ["after", "Next view", "]"],
  ["reset", "First view", "Home"],
  ["fit", "See all of it", "F"],
  ["split", "Compare two levels", "C"],
  ["overlay", "Figures", "I"],
  ["picture", "Save a picture", "P"],
  ["theme", "Light or dark", ""],
  ["full", "Full screen", ""],
  ["help", "Keys and gestures", "?"],
] as const;
export type ButtonName = (typeof BUTTONS)[number][0];
/** Those that stay beside the level where the others become a menu. */
const ALWAYS: ReadonlySet<ButtonName> = new Set<ButtonName>(["before", "after"]);

const DIVIDER = [
  ["role", "separator"],
  ["aria-orientation", "vertical"],
  ["aria-label", "Between the two levels"],
  ["aria-valuemin", "0"],
  ["aria-valuemax", "100"],
] as const;

export interface Parts extends Stage {
  /** Row of buttons, and what moves into a menu where it is narrow. */
  readonly bar: HTMLElement;
  readonly more: HTMLElement;
  readonly menu: HTMLButtonElement;
  readonly help: HTMLElement;
  readonly facts: HTMLElement;
  /** Where a running training tells how it goes. */
  readonly training: HTMLElement;
  readonly level: HTMLInputElement;
  readonly levelName: HTMLOutputElement;
  /** Level left of the divider. */
  readonly left: HTMLInputElement;
  readonly leftName: HTMLOutputElement;
  readonly divider: HTMLElement;
  readonly buttons: ReadonlyMap<ButtonName, HTMLButtonElement>;
}

export function build(core: Stage): Parts {
  const { root, room, stage, top } = core;
  make("style", "", root).textContent = STYLE;
  stage.setAttribute("role", "application");
  stage.setAttribute("aria-label", SUMMARY);
  const divider = make("div", "divider", room);
  stage.after(divider);
  divider.hidden = true;
  divider.tabIndex = 0;
  for (const [name, value] of DIVIDER) divider.setAttribute(name, value);
  const facts = make("div", "panel facts", top);
  top.prepend(facts);
  facts.hidden = true;
  const training = make("section", "panel training", top);
  training.hidden = true;
  training.setAttribute("aria-label", "Training");
  return { ...core, facts, training, divider, ...buildBar(room), help: buildHelp(room) };
}

function buildBar(room: HTMLElement) {
  const bar = make("div", "panel bar", make("div", "dock", room));
  bar.setAttribute("role", "group");
  bar.setAttribute("aria-label", "Viewer");
  const slider = (text: string) => {
    const label = make("label", "", bar);
    make("span", "", label).textContent = text;
    const input = make("input", "", label);
    input.type = "range";
    input.setAttribute("aria-label", text);
    return [input, make("output", "", label)] as const;
  };
  const buttons = new Map<ButtonName, HTMLButtonElement>();
  const add = (always: boolean, parent: HTMLElement) => {
    for (const [name, text, key] of BUTTONS) if (ALWAYS.has(name) === always) buttons.set(name, buildButton(name, text, key, parent));
  };
  add(true, bar);
  const [left, leftName] = slider("Left level");
  const [level, levelName] = slider("Level");
  const more = make("div", "more", bar);
  more.id = "more";
  add(false, more);
  const menu = buildButton("menu", "More", "", bar);
  menu.classList.add("menu");
  menu.setAttribute("aria-controls", more.id);
  menu.setAttribute("aria-expanded", "false");
  return { bar, more, menu, left, leftName, level, levelName, buttons };
}

function buildButton(name: ButtonName | "menu", text: string, key: string, parent: HTMLElement): HTMLButtonElement {
  const button = make("button", "", parent);
  button.type = "button";
  button.innerHTML = icon(name);
  button.setAttribute("aria-label", text);
  if (key) button.setAttribute("aria-keyshortcuts", key);
  const label = make("span", "label", button);
  make("span", "", label).textContent = text;
  if (key) make("kbd", "", label).textContent = key;
  return button;
}

function buildHelp(room: HTMLElement): HTMLElement {
  const help = make("div", "panel help", room);
  help.hidden = true;
  help.setAttribute("role", "dialog");
  help.setAttribute("aria-label", "Keys and gestures");
  const header = make("header", "", help);
  make("h2", "", header).textContent = "Keys and gestures";
  const close = make("button", "close", header);
  close.type = "button";
  close.innerHTML = icon("close");
  close.setAttribute("aria-label", "Close");
  const columns = make("div", "columns", help);
  for (const column of HELP) {
    const place = make("div", "", columns);
    for (const [title, rows] of column) {
      const part = make("section", title.toLowerCase(), place);
      make("h3", "", part).textContent = title;
      const list = make("dl", "", part);
      for (const [keys, meaning] of rows) {
        const term = make("dt", "", list);
        // Words stand as they are; what is pressed stands in frames.
        for (const word of keys.split(" ")) {
          if (/^[a-z,]/.test(word)) term.append(`${word} `);
          else {
            make("kbd", "", term).textContent = word;
            term.append(" ");
          }
        }
        make("dd", "", list).textContent = meaning;
      }
    }
  }
  return help;
}
