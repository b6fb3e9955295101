/** The pictures on the buttons: strokes on a grid of 24, in the colour of the text. */

const PATHS = {
  reset: '<path d="M4 11.5 12 4l8 7.5M6.5 9.5V20h11V9.5"/>',
  fit: '<path d="m12 3.5 7.5 4.2v8.6L12 20.5l-7.5-4.2V7.7zM4.5 7.7 12 12l7.5-4.3M12 12v8.5"/>',
  tour: '<path d="M6.5 21V4h11l-3 4 3 4h-11"/>',
  walk: '<circle cx="13" cy="4.3" r="1.6"/><path d="m8.5 20.5 2.5-6M14.5 20.5 13.5 16l-2.5-2 1-5.5 3 3.5h3M7.5 12.5 8.5 9l3.5-1.5"/>',
  before: '<path d="m14.5 5.5-6.5 6.5 6.5 6.5"/>',
  after: '<path d="m9.5 5.5 6.5 6.5-6.5 6.5"/>',
  split: '<rect x="3.5" y="5.5" width="17" height="13" rx="1.5"/><path d="M12 3v18"/><path d="M4 6h8v12H4z" fill="currentColor" stroke="none" opacity=".45"/>',
  overlay: '<path d="M5.5 19.5v-6M12 19.5v-15M18.5 19.5v-10"/>',
  picture: '<path d="M4 8h3.7l1.6-2.5h5.4L16.3 8H20v11H4z"/><circle cx="12" cy="13.3" r="3.2"/>',
  theme: '<circle cx="12" cy="12" r="8"/><path d="M12 4a8 8 0 0 1 0 16z" fill="currentColor" stroke="none"/>',
  full: '<path d="M4.5 9V4.5H9M15 4.5h4.5V9M19.5 15v4.5H15M9 19.5H4.5V15"/>',
  headset: '<path d="M3.5 7.5h17v9h-5l-2-2.5h-3l-2 2.5h-5z"/>',
  help: '<circle cx="12" cy="12" r="8.5"/><path d="M9.6 9.7a2.5 2.5 0 1 1 3.7 2.1c-.9.5-1.3 1-1.3 1.9M12 16.6v.1"/>',
  menu: '<path d="M5.5 12h.01M12 12h.01M18.5 12h.01" stroke-width="3"/>',
  close: '<path d="m6 6 12 12M18 6 6 18"/>',
} as const;

export type IconName = keyof typeof PATHS;

export function icon(name: IconName): string {
  return (
    '<svg viewBox="0 0 24 24" width="20" height="20" fill="none" stroke="currentColor" stroke-width="1.7" ' +
    `stroke-linecap="round" stroke-linejoin="round" aria-hidden="true">${PATHS[name]}</svg>`
  );
}
