/** Keys: what they do beside moving the camera, whose they are, and how people are told. */

/** Buttons: what they are called, and the key that does the same. */
export const BUTTONS = [
  ["before", "View before", "["],
  ["after", "Next view", "]"],
  ["reset", "First view", "Home"],
  ["fit", "See all of it", "F"],
  ["walk", "Walk", "G"],
  ["tour", "Tour of the notes", "N"],
  ["split", "Compare two levels", "C"],
  ["overlay", "Figures", "I"],
  ["picture", "Save a picture", "P"],
  ["theme", "Light or dark", ""],
  ["full", "Full screen", ""],
  ["headset", "Headset", "V"],
  ["help", "Keys and gestures", "?"],
] as const;
export type ButtonName = (typeof BUTTONS)[number][0];

/** Keys that press a button, as they are written on it. */
const SHORTCUTS: ReadonlyMap<string, ButtonName> = new Map([
  ["home", "reset"],
  ["f", "fit"],
  ["g", "walk"],
  ["n", "tour"],
  ["[", "before"],
  ["]", "after"],
  ["c", "split"],
  ["i", "overlay"],
  ["p", "picture"],
  ["v", "headset"],
  ["?", "help"],
]);
/** The keys beside P by place, for layouts with other letters on them. */
const BRACKETS: ReadonlyMap<string, ButtonName> = new Map([["BracketLeft", "before"], ["BracketRight", "after"]]);
/** Keys that scroll a page or move a slider. */
const SCROLLING = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"]);

export function shortcutOf(event: KeyboardEvent): ButtonName | undefined {
  return SHORTCUTS.get(event.key.toLowerCase()) ?? BRACKETS.get(event.code);
}

/**
 * True for a key that is for this viewer: with the focus in it; or, with the focus nowhere, from the whole page if
 * the viewer asked for it (`keys`), else where the pointer is over it and the page would not scroll.
 */
export function isForViewer(event: KeyboardEvent, host: HTMLElement, over: boolean): boolean {
  if (event.defaultPrevented || event.isComposing || event.ctrlKey || event.metaKey || event.altKey) return false;
  const path = event.composedPath();
  const target = path[0] instanceof HTMLElement ? path[0] : document.body;
  const scrolls = SCROLLING.has(event.key);
  if (path.includes(host)) return !target.closest("textarea, input:not([type=range])") && !(scrolls && target.closest("input, .help"));
  if (isField(target)) return false;
  if (host.hasAttribute("keys")) return true;
  return over && !scrolls && (target === document.body || target === document.documentElement);
}

/** Something to write into, or to choose from. */
function isField(target: HTMLElement): boolean {
  return target.isContentEditable || target.closest("input, textarea, select, [role=textbox], [role=listbox]") !== null;
}

export const SUMMARY =
  "A scene in three dimensions. Drag or arrow keys turn around it, two fingers or the right button " +
  "shift it, wheel, pinch, plus and minus zoom, W A S D Q E fly. The question mark lists all keys.";

type Rows = readonly (readonly [keys: string, meaning: string])[];

/** Columns of titled lists; what begins with a small letter is words, the rest are keys. */
export const HELP: readonly (readonly (readonly [title: string, rows: Rows])[])[] = [
  [
    ["Mouse", [
      ["drag", "turn around the scene"],
      ["double click", "look there"],
      ["right drag", "shift it"],
      ["Shift drag", "shift it"],
      ["middle drag", "look around"],
      ["Ctrl drag", "look around"],
      ["wheel", "nearer, farther"],
      ["Ctrl wheel", "nearer, farther"],
    ]],
    ["Touch", [
      ["one finger", "turn around the scene"],
      ["two fingers", "shift it"],
      ["pinch", "nearer, farther"],
      ["double tap", "look there"],
    ]],
  ],
  [
    ["Keys", [
      ["← → ↑ ↓", "turn around the scene"],
      ["W A S D", "fly, faster with Shift"],
      ["Q E", "fly down, up"],
      ["+ -", "nearer, farther"],
      ["[ ]", "Next view"],
      ["Home", "First view"],
      ["F", "See all of it"],
      ["G", "Walk"],
      ["N", "Next note"],
      ["M", "make a note"],
      ["C", "Compare two levels"],
      ["I", "Figures"],
      ["P", "Save a picture"],
      ["?", "Keys and gestures"],
      ["Esc", "Close"],
    ]],
  ],
];
