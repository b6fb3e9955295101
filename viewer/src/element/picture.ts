/** The image on screen as a file. */

import type { SceneView } from "../render/scene-view";
import { captureImage } from "../render/supersampling";

/** A PNG file of what a scene shows, before the first of these elements that has a background. */
export async function pictureOf(scene: SceneView, behind: readonly HTMLElement[]): Promise<Blob> {
  const { width, height, pixels } = await captureImage(scene);
  const canvas = new OffscreenCanvas(width, height);
  putBackground(pixels, behind);
  canvas.getContext("2d")!.putImageData(new ImageData(pixels as Uint8ClampedArray<ArrayBuffer>, width, height), 0, 0);
  return canvas.convertToBlob({ type: "image/png" });
}

/** Put the background behind a picture, RGBA8, colours times alpha. */
function putBackground(pixels: Uint8ClampedArray, parts: readonly HTMLElement[]): void {
  const colours = parts.map((part) => getComputedStyle(part).backgroundColor);
  // The nearest one that is not clear: rgb(…), or rgba(…) of alpha above 0.
  const behind = colours.map((text) => (text.match(/[\d.]+/g) ?? []).map(Number)).find(([, , , alpha = 1]) => alpha > 0) ?? [0, 0, 0];
  for (let p = 0; p < pixels.length; p += 4) {
    const rest = 1 - pixels[p + 3] / 255;
    for (let c = 0; c < 3; c++) pixels[p + c] += rest * behind[c];
    pixels[p + 3] = 255;
  }
}
