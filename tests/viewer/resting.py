"""What is on the viewer's canvas once nothing moves any more, without asking it for a picture."""

from typing import Any

AT_REST = """
// From now on `last` is what was drawn last; a screenshot may show the frame before it. `asked` is
// the serial of the last change of what is shown. A view told later has a later one, which nothing
// answers where the camera has not moved.
globalThis.watchFrames = () => {
  const { scene } = viewer();
  globalThis.asked = 0;
  for (const name of ["setLevel", "compare", "setPinhole"]) {
    const change = scene[name].bind(scene);
    scene[name] = (value) => {
      change(value);
      globalThis.asked = scene.serial;
    };
  }
  const { events } = scene;
  const { frame } = events;
  const canvas = viewer().shadowRoot.querySelector("canvas");
  const { width, height } = canvas;
  globalThis.last = new OffscreenCanvas(width, height).getContext("2d");
  events.frame = () => {
    frame();
    // The page behind what the canvas leaves clear is black.
    last.fillRect(0, 0, width, height);
    last.drawImage(canvas, 0, 0);
  };
  // What was drawn last may have been drawn before.
  scene.wake();
};
// What is on the canvas once the last change is sorted on its side and no frame follows by itself.
// Nothing is asked for meanwhile: that would tell workers of the camera.
globalThis.atRest = async (side) => {
  const { scene } = viewer();
  const pause = (milliseconds) => new Promise((go) => setTimeout(go, milliseconds));
  while (side !== null && !(scene.panes[side].sortedFor >= asked)) await pause(20);
  // What is drawn larger takes the place of a frame 120 ms after it.
  for (let before = -1; before !== scene.lastFrame || scene.handle; await pause(200)) {
    before = scene.lastFrame;
  }
  const { width, height } = last.canvas;
  return { width, height, pixels: bytes(last.getImageData(0, 0, width, height).data) };
};
"""
READY: list[dict[str, Any]] = [
    {"wait": "complete"},
    {"until": "viewer().tools !== null"},
    {"name": "_", "script": "watchFrames()"},
]


def at_pace(milliseconds: float) -> dict[str, Any]:
    """A step after which the scene takes its device for one of so many milliseconds a frame."""
    pace = f"{{ get: () => {milliseconds}, set() {{}}, configurable: true }}"
    return {
        "name": "_",
        "script": f"Object.defineProperty(viewer().scene.pace, 'milliseconds', {pace}), 0",
    }
