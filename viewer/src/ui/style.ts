/** Looks of what is around the picture. Widths are those of the element, not of the window: it may be a small part of a page. */

export const STYLE = `
.stage:not(.mouse):focus-visible::after { content: ""; position: absolute; inset: 0; box-shadow: inset 0 0 0 2px var(--accent); }
.divider { position: absolute; top: 0; bottom: 0; left: 50%; width: 24px; margin-left: -12px; cursor: ew-resize;
  touch-action: none; background: linear-gradient(var(--accent) 0 0) center / 2px 100% no-repeat; outline: none; }
.divider::before, .divider::after { content: attr(data-left); position: absolute; top: 50%; right: 20px; padding: 2px 8px;
  border-radius: 6px; background: var(--panel); border: 1px solid var(--line); font-size: 12px; }
.divider::after { content: attr(data-right); right: auto; left: 20px; }
.divider:focus-visible { box-shadow: 0 0 0 2px var(--accent); }
.facts { grid-column: 1; grid-row: 1; justify-self: start; padding: 8px 12px; white-space: pre;
  font: 12px/1.5 ui-monospace, monospace; }
.training { grid-column: 3; grid-row: 1; justify-self: end; width: 232px; padding: 10px 12px; font-size: 12px; }
.training header { display: flex; justify-content: space-between; gap: 8px; font-weight: 600; }
.training .share { height: 3px; margin: 6px 0; border-radius: 2px; background: var(--lift); overflow: hidden; }
.training i { display: block; height: 100%; background: var(--accent); }
.training dl { display: grid; grid-template-columns: auto 1fr; gap: 1px 8px; margin: 0; white-space: nowrap; }
.training dt { color: var(--faint); }
dd { margin: 0; }
.training dd { text-align: right; }
.training dd, .bar output { font-variant-numeric: tabular-nums; }
.training svg { display: block; width: 100%; height: 44px; margin-top: 6px; }
.training svg * { fill: none; stroke: var(--line); vector-effect: non-scaling-stroke; }
.training polyline { stroke: var(--accent); stroke-width: 1.5; }

button { font: inherit; color: inherit; background: none; border: 0; border-radius: 7px; padding: 0 7px; position: relative;
  min-width: 34px; height: 34px; display: inline-flex; align-items: center; justify-content: center; flex: none; cursor: pointer; }
button[aria-pressed="true"], button[aria-expanded="true"] { color: var(--accent); background: var(--lift); }
button:focus-visible, input:focus-visible { outline: 2px solid var(--accent); outline-offset: -1px; }
kbd { font: 12px/1.5 ui-monospace, monospace; padding: 0 5px; border: 1px solid var(--line); border-radius: 4px;
  white-space: nowrap; }
.dock { position: absolute; inset: auto 12px max(12px, env(safe-area-inset-bottom)); display: flex; justify-content: center;
  pointer-events: none; transition: opacity .4s; }
.dots { position: absolute; inset: 0; pointer-events: none; overflow: hidden; }
.dot { position: absolute; transform: translate(-50%, -50%); min-width: 26px; height: 26px; padding: 0 6px; border-radius: 13px;
  pointer-events: auto; background: var(--panel); border: 1px solid var(--line); font-size: 12px;
  transition: opacity .2s; }
.dot.behind:not([aria-current], :hover, :focus-visible) { opacity: .25; }
.dot[aria-current] { background: var(--accent); color: var(--solid); }
.card { position: absolute; left: 12px; bottom: 68px; width: min(320px, 100% - 24px); max-height: calc(100% - 80px); overflow: auto;
  padding: 4px 12px 12px; overflow-wrap: anywhere; background: var(--solid); }
.card header { display: flex; align-items: center; margin-right: -8px; }
.card b { flex: 1; color: var(--faint); font-weight: 600; font-size: 12px; }
.card h3 { margin: 0; font-size: 15px; }
.card p { margin: 4px 0 0; white-space: pre-line; }
.card input, .card textarea { display: block; width: 100%; margin-top: 6px; padding: 6px 8px; font: inherit; color: inherit; resize: vertical;
  background: var(--lift); border: 1px solid var(--line); border-radius: 6px; }
.card footer { display: flex; gap: 8px; margin-top: 8px; }
.card footer button { border: 1px solid var(--line); padding: 0 12px; }
.hint { position: absolute; left: 50%; bottom: 72px; transform: translateX(-50%); width: max-content; max-width: calc(100% - 24px); padding: 6px 12px;
  pointer-events: none; text-align: center; }
.idle .dock:not(:hover, :has(:focus-visible, .open)) { opacity: 0; }
.bar { position: relative; display: flex; align-items: center; gap: 2px; padding: 4px; pointer-events: auto; }
.bar label { display: flex; gap: 6px; align-items: center; padding: 0 6px; height: 34px; }
.bar output { min-width: 4ch; }
.more { display: flex; gap: 2px; padding-left: 5px; margin-left: 3px; border-left: 1px solid var(--line); }
.menu { display: none; }
input[type=range] { width: 88px; margin: 0; accent-color: var(--accent); cursor: pointer; }
button .label { position: absolute; bottom: calc(100% + 10px); left: 50%; transform: translateX(-50%); padding: 4px 8px;
  display: flex; gap: 8px; white-space: nowrap; border-radius: 6px; background: var(--panel); border: 1px solid var(--line);
  visibility: hidden; pointer-events: none; color: var(--ink); font-size: 12px; }
button:focus-visible .label { visibility: visible; }
.bar:has(button:hover) button:not(:hover) .label { visibility: hidden; }
@media (hover: hover) {
  button:hover { background: var(--lift); }
  button:hover .label { visibility: visible; transition: visibility 0s .4s; }
}

.help { position: absolute; inset: 12px 12px 64px; margin: auto; width: fit-content; height: fit-content;
  max-width: 620px; max-height: calc(100% - 76px); overflow: auto; padding: 8px 8px 16px 16px; overscroll-behavior: contain;
  background: var(--solid); }
.help header { display: flex; align-items: center; justify-content: space-between; }
.help h2 { font-size: 15px; line-height: 34px; margin: 0; }
.help h3 { font-size: 12px; margin: 8px 0 4px; color: var(--faint); font-weight: 600; }
.help .columns { display: grid; grid-template-columns: 1fr 1fr; gap: 0 24px; }
.help dl { display: grid; grid-template-columns: minmax(92px, auto) 1fr; gap: 4px 12px; margin: 0; align-items: baseline;
  font-size: 13px; }
.help dt { white-space: nowrap; }

@media (pointer: coarse) {
  button { min-width: 40px; height: 40px; }
  .bar label, input[type=range] { height: 40px; }
  .more kbd { display: none; }
  .idle .dock:not(:has(.open)) .bar { pointer-events: none; }
  .help .mouse, .help .keys { display: none; }
  .help .columns { grid-template-columns: 1fr; }
}
@container room (width < 780px) {${narrow(".split ")} }
@container room (width < 640px) {${narrow("")}
  button { min-width: 40px; height: 40px; }
  .bar label { height: 40px; }
  .top { grid-template-columns: 1fr auto; }
  .note { grid-column: 1 / -1; grid-row: 1; justify-self: center; }
  .facts { grid-row: 2; padding: 6px 10px; font-size: 11px; }
  .training { grid-column: 2; grid-row: 2; width: 228px; padding: 8px 10px; }
  .split input[type=range] { width: 60px; }
}
@container room (height < 240px) { .hint { display: none; } }
@container room (width < 380px) { .split > button:not(.menu) { display: none; } }
@container room (width < 540px) { .help .columns { grid-template-columns: 1fr; } }
@container room (height < 420px) {
  .more { --columns: 2; }
  .help { inset: 8px; max-height: calc(100% - 16px); }
  .help dl { font-size: 12px; gap: 1px 10px; }
  .training svg { height: 28px; margin-top: 2px; }
}
`;

/** Rules of a bar without room for one row: most buttons move into a menu. */
function narrow(kind: string): string {
  return `
  ${kind}.menu { display: inline-flex; }
  ${kind}label > span { display: none; }
  ${kind}.more { position: absolute; left: 50%; bottom: calc(100% + 8px); display: none; padding: 4px;
    transform: translateX(-50%); width: max-content; margin: 0;
    border: 1px solid var(--line); border-radius: 10px; background: var(--solid);
    grid-template-columns: repeat(var(--columns, 1), auto); }
  ${kind}.more.open { display: grid; }
  ${kind}.more label { padding: 0 12px; gap: 12px; }
  ${kind}.more label > span { display: inline; flex: 1; }
  ${kind}.more button { justify-content: start; gap: 10px; padding: 0 12px 0 9px; }
  ${kind}.more .label { position: static; transform: none; visibility: visible !important; transition: none !important; flex: 1;
    justify-content: space-between; align-items: center; gap: 16px; padding: 0; border: 0; background: none; color: inherit;
    font-size: 14px; }`;
}
