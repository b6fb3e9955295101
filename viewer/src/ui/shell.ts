/** The part of the element that the first image needs: its canvas, and a line for messages. */

const LIGHT = `--ink: #16161a; --faint: rgb(22 22 26 / 62%); --panel: rgb(252 252 254 / 92%); --solid: rgb(252 252 254 / 98%);
  --line: rgb(0 0 0 / 14%); --lift: rgb(0 0 0 / 8%); --accent: #1456b8; color-scheme: light;`;

const STYLE = `
:host { display: block; position: relative; overflow: hidden; background: #000; outline: none;
  --ink: #f4f4f6; --faint: rgb(244 244 246 / 66%); --panel: rgb(24 24 28 / 86%); --solid: rgb(24 24 28 / 98%);
  --line: rgb(255 255 255 / 16%); --lift: rgb(255 255 255 / 12%); --accent: #8ab9ff; color-scheme: dark;
  font: 14px/1.4 system-ui, sans-serif; color: var(--ink); }
:host([theme="light"]) { ${LIGHT} }
@media (prefers-color-scheme: light) { :host(:not([theme])) { ${LIGHT} } }
:host::before { content: ""; display: block; padding-top: 56.25%; }
* { box-sizing: border-box; }
[hidden] { display: none !important; }
.room { position: absolute; inset: 0; container: room / size; }
.stage, canvas { position: absolute; inset: 0; width: 100%; height: 100%; }
.stage { outline: none; cursor: grab; touch-action: pan-y; user-select: none; -webkit-user-select: none; }
canvas.poster { inset: -5%; width: 110%; height: 110%; object-fit: cover; filter: blur(2vmin); }
:host([wheel]) .stage { touch-action: none; }
.stage:active { cursor: grabbing; }
.panel { background: var(--panel); border: 1px solid var(--line); border-radius: 10px; }
progress { position: absolute; left: 0; top: 0; width: 100%; height: 3px; border: 0; background: none; appearance: none; }
progress::-webkit-progress-bar { background: none; }
progress::-webkit-progress-value { background: var(--accent); }
progress::-moz-progress-bar { background: var(--accent); }

.top { position: absolute; inset: max(12px, env(safe-area-inset-top)) 12px auto; display: grid; gap: 8px;
  grid-template-columns: 1fr minmax(0, auto) 1fr; align-items: start; pointer-events: none; }
.note { grid-column: 2; grid-row: 1; max-width: 36em; padding: 8px 12px; overflow-wrap: anywhere; pointer-events: auto; }
.trouble { border-color: #d9534f; }`;

/** The parts that are there from the start. */
export interface Shell {
  readonly root: ShadowRoot;
  readonly room: HTMLElement;
  readonly stage: HTMLElement;
  readonly canvas: HTMLCanvasElement;
  readonly top: HTMLElement;
  readonly note: HTMLElement;
  readonly progress: HTMLProgressElement;
}

/** A child of a class. */
export function appendElement<K extends keyof HTMLElementTagNameMap>(tag: K, name: string, parent: Node): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (name) element.className = name;
  parent.appendChild(element);
  return element;
}

/** Add rules; a page's policy against inline styles does not hold them back. */
export function addStyle(root: ShadowRoot, text: string): void {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(text);
  root.adoptedStyleSheets.push(sheet);
}

export function buildShell(root: ShadowRoot): Shell {
  addStyle(root, STYLE);
  const room = appendElement("div", "room", root);
  const stage = appendElement("div", "stage", room);
  stage.tabIndex = 0;
  const canvas = appendElement("canvas", "", stage);
  const progress = appendElement("progress", "", room);
  progress.setAttribute("aria-label", "Loaded");
  const top = appendElement("div", "top", room);
  const note = appendElement("div", "panel note", top);
  note.setAttribute("role", "status");
  note.textContent = "Loading…";
  return { root, room, stage, canvas, top, note, progress };
}
