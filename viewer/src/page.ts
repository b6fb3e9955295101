/** Structure and looks of the element. */

export const STYLE = `
:host { display: block; position: relative; overflow: hidden; background: #000;
  --ink: #f2f2f2; --panel: rgb(22 22 26 / 82%); --line: rgb(255 255 255 / 22%); --accent: #7fb4ff;
  font: 14px/1.4 system-ui, sans-serif; color: var(--ink); }
:host([theme="light"]) { --ink: #16161a; --panel: rgb(250 250 252 / 88%); --line: rgb(0 0 0 / 20%); --accent: #1456b8; }
@media (prefers-color-scheme: light) { :host(:not([theme])) { --ink: #16161a;
  --panel: rgb(250 250 252 / 88%); --line: rgb(0 0 0 / 20%); --accent: #1456b8; } }
.stage, canvas { position: absolute; inset: 0; width: 100%; height: 100%; }
.divider { position: absolute; top: 0; bottom: 0; left: 50%; width: 24px; margin-left: -12px; cursor: ew-resize;
  touch-action: none; background: linear-gradient(var(--accent), var(--accent)) center / 2px 100% no-repeat; outline: none; }
.divider::before, .divider::after { content: attr(data-left); position: absolute; top: 50%; right: 24px; padding: 2px 8px;
  border-radius: 6px; background: var(--panel); }
.divider::after { content: attr(data-right); right: auto; left: 24px; }
.divider:focus-visible { box-shadow: 0 0 0 2px var(--accent); }
.stage { outline: none; cursor: grab; }
.stage:focus-visible { box-shadow: inset 0 0 0 2px var(--accent); }
.panel { position: absolute; background: var(--panel); border: 1px solid var(--line); border-radius: 8px;
  padding: 6px 10px; }
.bar { left: 50%; bottom: max(12px, env(safe-area-inset-bottom)); transform: translateX(-50%); display: flex;
  gap: 4px; align-items: center; max-width: calc(100% - 24px); flex-wrap: wrap; justify-content: center; }
.facts { left: 12px; top: 12px; white-space: pre; font: 12px/1.5 ui-monospace, monospace; pointer-events: none; }
.note { left: 50%; top: 12px; transform: translateX(-50%);
  width: max-content; box-sizing: border-box; max-width: min(36em, calc(100% - 24px)); }
.trouble { border-color: #d9534f; }
[hidden] { display: none !important; }
button { font: inherit; color: inherit; background: none; border: 1px solid transparent; border-radius: 6px;
  min-width: 34px; min-height: 34px; cursor: pointer; }
button:hover { border-color: var(--line); }
button[aria-pressed="true"] { border-color: var(--accent); }
button:focus-visible, input:focus-visible { outline: 2px solid var(--accent); }
label { display: flex; gap: 6px; align-items: center; }
input[type=range] { width: 84px; accent-color: var(--accent); }
output { min-width: 5ch; }
progress { position: absolute; left: 0; top: 0; width: 100%; height: 3px; border: 0; background: none;
  appearance: none; }
progress::-webkit-progress-bar { background: none; }
progress::-webkit-progress-value { background: var(--accent); }
progress::-moz-progress-bar { background: var(--accent); }
`;

export const BUTTONS = [
  ["reset", "First", "First view (Home)"],
  ["fit", "Whole", "See all of it (F)"],
  ["before", "‹", "View before ([)"],
  ["after", "›", "Next view (])"],
  ["split", "Split", "Compare two levels (C)"],
  ["overlay", "Figures", "Figures (I)"],
  ["theme", "Theme", "Light or dark"],
  ["picture", "Picture", "Save a picture (P)"],
  ["full", "Full", "Full screen"],
] as const;
export type ButtonName = (typeof BUTTONS)[number][0];

/** Keys of the page, beside those that move the camera. */
export const SHORTCUTS: ReadonlyMap<string, ButtonName> = new Map([
  ["Home", "reset"],
  ["KeyF", "fit"],
  ["BracketLeft", "before"],
  ["BracketRight", "after"],
  ["KeyC", "split"],
  ["KeyI", "overlay"],
  ["KeyP", "picture"],
]);

const DIVIDER = [
  ["role", "separator"],
  ["aria-orientation", "vertical"],
  ["aria-label", "Between the two levels"],
  ["aria-valuemin", "0"],
  ["aria-valuemax", "100"],
] as const;

export const HELP =
  "A scene in three dimensions. Drag or arrow keys turn around it, two fingers or the right button " +
  "shift it, wheel, pinch, plus and minus zoom, W A S D Q E fly.";

export interface Parts {
  readonly stage: HTMLElement;
  readonly canvas: HTMLCanvasElement;
  readonly bar: HTMLElement;
  readonly facts: HTMLElement;
  readonly note: HTMLElement;
  readonly progress: HTMLProgressElement;
  readonly level: HTMLInputElement;
  readonly levelName: HTMLOutputElement;
  /** Level left of the divider. */
  readonly left: HTMLInputElement;
  readonly leftName: HTMLOutputElement;
  readonly divider: HTMLElement;
  readonly buttons: ReadonlyMap<ButtonName, HTMLButtonElement>;
}

export function build(root: ShadowRoot): Parts {
  const make = <K extends keyof HTMLElementTagNameMap>(tag: K, name: string, parent: Node): HTMLElementTagNameMap[K] => {
    const element = document.createElement(tag);
    element.className = name;
    parent.appendChild(element);
    return element;
  };
  make("style", "", root).textContent = STYLE;
  const stage = make("div", "stage", root);
  stage.tabIndex = 0;
  stage.setAttribute("role", "application");
  stage.setAttribute("aria-label", HELP);
  const canvas = make("canvas", "", stage);
  const divider = make("div", "divider", root);
  divider.hidden = true;
  divider.tabIndex = 0;
  for (const [name, value] of DIVIDER) divider.setAttribute(name, value);
  const progress = make("progress", "", root);
  progress.setAttribute("aria-label", "Loaded");
  const facts = make("div", "panel facts", root);
  facts.hidden = true;
  const note = make("div", "panel note", root);
  note.setAttribute("role", "status");
  note.textContent = "Loading…";
  const bar = make("div", "panel bar", root);
  bar.setAttribute("role", "toolbar");
  bar.setAttribute("aria-label", "Viewer");
  const slider = (text: string) => {
    const label = make("label", "", bar);
    label.append(text);
    const input = make("input", "", label);
    input.type = "range";
    return [input, make("output", "", label)] as const;
  };
  const [left, leftName] = slider("Left");
  const [level, levelName] = slider("Level");
  const buttons = new Map(
    BUTTONS.map(([name, sign, title]) => {
      const button = make("button", "", bar);
      button.type = "button";
      button.textContent = sign;
      button.title = title;
      button.setAttribute("aria-label", title);
      return [name, button] as const;
    }),
  );
  return { stage, canvas, bar, facts, note, progress, level, levelName, left, leftName, divider, buttons };
}
