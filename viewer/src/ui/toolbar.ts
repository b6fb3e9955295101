/** Buttons, sliders and panels around the canvas. */

import { icon } from "./icons";
import { BUTTONS, HELP, SUMMARY } from "./shortcuts";
import type { ButtonName } from "./shortcuts";
import { addStyle, appendElement } from "./shell";
import type { Shell } from "./shell";
import { STYLE } from "./style";
import { translated } from "./words";

/** Buttons that stay beside the level slider where the others become a menu. */
const ALWAYS: ReadonlySet<ButtonName> = new Set<ButtonName>(["before", "after"]);

const DIVIDER = [
  ["role", "separator"],
  ["aria-orientation", "vertical"],
  ["aria-label", "Between the two levels"],
  ["aria-valuemin", "0"],
  ["aria-valuemax", "100"],
] as const;

export interface Toolbar extends Shell {
  /** Row of buttons, and what moves into a menu where it is narrow. */
  readonly bar: HTMLElement;
  readonly more: HTMLElement;
  readonly menu: HTMLButtonElement;
  readonly help: HTMLElement;
  readonly facts: HTMLElement;
  /** Panel on a running training. */
  readonly training: HTMLElement;
  readonly level: HTMLInputElement;
  readonly levelName: HTMLOutputElement;
  /** Level left of the divider. */
  readonly left: HTMLInputElement;
  readonly leftName: HTMLOutputElement;
  readonly divider: HTMLElement;
  readonly buttons: ReadonlyMap<ButtonName, HTMLButtonElement>;
}

export function buildToolbar(core: Shell): Toolbar {
  const { root, room, stage, top } = core;
  addStyle(root, STYLE);
  stage.setAttribute("role", "application");
  stage.setAttribute("aria-label", SUMMARY);
  const divider = appendElement("div", "divider", room);
  stage.after(divider);
  divider.hidden = true;
  divider.tabIndex = 0;
  for (const [name, value] of DIVIDER) divider.setAttribute(name, value);
  const facts = appendElement("div", "panel facts", top);
  top.prepend(facts);
  facts.hidden = true;
  const training = appendElement("section", "panel training", top);
  training.hidden = true;
  training.setAttribute("aria-label", "Training");
  return { ...core, facts, training, divider, ...buildBar(room), help: buildHelp(room) };
}

function buildBar(room: HTMLElement) {
  const bar = appendElement("div", "panel bar", appendElement("div", "dock", room));
  bar.setAttribute("role", "group");
  bar.setAttribute("aria-label", "Viewer");
  const slider = (text: string) => {
    const label = appendElement("label", "", bar);
    appendElement("span", "", label).textContent = translated(text);
    const input = appendElement("input", "", label);
    input.type = "range";
    input.setAttribute("aria-label", translated(text));
    return [input, appendElement("output", "", label)] as const;
  };
  const buttons = new Map<ButtonName, HTMLButtonElement>();
  const add = (always: boolean, parent: HTMLElement) => {
    for (const [name, text, key] of BUTTONS) if (ALWAYS.has(name) === always) buttons.set(name, buildButton(name, text, key, parent));
  };
  add(true, bar);
  const [left, leftName] = slider("Left level");
  const [level, levelName] = slider("Level");
  const more = appendElement("div", "more", bar);
  more.id = "more";
  add(false, more);
  const menu = buildButton("menu", "More", "", bar);
  menu.classList.add("menu");
  menu.setAttribute("aria-controls", more.id);
  menu.setAttribute("aria-expanded", "false");
  return { bar, more, menu, left, leftName, level, levelName, buttons };
}

function buildButton(name: ButtonName | "menu", text: string, key: string, parent: HTMLElement): HTMLButtonElement {
  const button = appendElement("button", "", parent);
  button.type = "button";
  button.innerHTML = icon(name);
  button.setAttribute("aria-label", translated(text));
  if (key) button.setAttribute("aria-keyshortcuts", key);
  const label = appendElement("span", "label", button);
  appendElement("span", "", label).textContent = translated(text);
  if (key) appendElement("kbd", "", label).textContent = key;
  return button;
}

function buildHelp(room: HTMLElement): HTMLElement {
  const help = appendElement("div", "panel help", room);
  help.hidden = true;
  help.setAttribute("role", "dialog");
  help.setAttribute("aria-label", translated("Keys and gestures"));
  const header = appendElement("header", "", help);
  appendElement("h2", "", header).textContent = translated("Keys and gestures");
  const close = appendElement("button", "close", header);
  close.type = "button";
  close.innerHTML = icon("close");
  close.setAttribute("aria-label", translated("Close"));
  const columns = appendElement("div", "columns", help);
  for (const column of HELP) {
    const place = appendElement("div", "", columns);
    for (const [title, rows] of column) {
      const part = appendElement("section", title.toLowerCase(), place);
      appendElement("h3", "", part).textContent = translated(title);
      const list = appendElement("dl", "", part);
      for (const [keys, meaning] of rows) {
        const term = appendElement("dt", "", list);
        // Words stand as they are; what is pressed stands in frames.
        for (const word of /^[a-z]/.test(keys) ? [keys] : keys.split(" ")) {
          if (/^[a-z]/.test(word)) term.append(`${translated(word)} `);
          else {
            appendElement("kbd", "", term).textContent = word;
            term.append(" ");
          }
        }
        appendElement("dd", "", list).textContent = translated(meaning);
      }
    }
  }
  return help;
}
