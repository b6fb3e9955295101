/** Events of the element, with their types. */

import type { Trouble } from "../base/errors";
import type { SceneFacts } from "../decode/messages";
import type { ViewerCamera } from "../camera/camera-api";

/** Type of `detail` of each event. */
export interface ViewerEvents {
  /** Sizes, levels and notes of the file are known. */
  readonly header: Omit<SceneFacts, "levels"> & { readonly levels: number };
  /** The coarsest level is on screen. */
  readonly "base-ready": { readonly bytes: number; readonly seconds: number };
  /** A level is decoded. */
  readonly "level-ready": { readonly level: number; readonly bytes: number; readonly seconds: number };
  /** The finest level that is shown here is decoded. */
  readonly complete: { readonly bytes: number; readonly seconds: number };
  /** The camera moved; ten times a second at most. */
  readonly "camera-change": ViewerCamera;
  /** The line of text on the scene is another one, such as of a host that does not answer yet; empty when it is gone. */
  readonly "viewer-notice": { readonly message: string };
  /** The file cannot be shown, or not further; not `error`, which pages keep for scripts that broke. */
  readonly "viewer-error": { readonly trouble: Trouble; readonly message: string };
}

/** The events themselves, by name. They bubble, so that a page may listen at `window`. */
export type ViewerEventMap = { readonly [Name in keyof ViewerEvents]: CustomEvent<ViewerEvents[Name]> };

type Listener<This, Event> = (this: This, event: Event) => unknown;

/** An HTML element whose listeners know these events. */
export interface ViewerBase extends HTMLElement {
  addEventListener<K extends keyof ViewerEventMap>(
    type: K, listener: Listener<this, ViewerEventMap[K]>, options?: boolean | AddEventListenerOptions): void;
  addEventListener<K extends keyof HTMLElementEventMap>(
    type: K, listener: Listener<HTMLElement, HTMLElementEventMap[K]>, options?: boolean | AddEventListenerOptions): void;
  addEventListener(
    type: string, listener: EventListenerOrEventListenerObject, options?: boolean | AddEventListenerOptions): void;
  removeEventListener<K extends keyof ViewerEventMap>(
    type: K, listener: Listener<this, ViewerEventMap[K]>, options?: boolean | EventListenerOptions): void;
  removeEventListener<K extends keyof HTMLElementEventMap>(
    type: K, listener: Listener<HTMLElement, HTMLElementEventMap[K]>, options?: boolean | EventListenerOptions): void;
  removeEventListener(
    type: string, listener: EventListenerOrEventListenerObject, options?: boolean | EventListenerOptions): void;
}

/* eslint-disable @typescript-eslint/no-empty-object-type -- an interface of the browser can only be extended */
declare global {
  interface WindowEventMap extends ViewerEventMap {}
  interface DocumentEventMap extends ViewerEventMap {}
}
