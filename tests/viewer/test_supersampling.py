"""Windows smaller than the photos of training: what stands still is drawn larger and reduced."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.viewer.browser import MISSING, SIZE, pages, pinhole, pixels, psnr, visit
from gsynopsis.container import encode
from gsynopsis.model.training_focals import focals_text
from gsynopsis.records import FOCALS_NOTE, LevelSet
from gsynopsis.scene.camera import Camera
from tests.viewer.bright import LEAST_DB, bright_levels, camera_of, drawn_by_cpu
from tests.viewer.resting import AT_REST, READY

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
# The second of two frames, on a device that was found to be quick or slow.
MOVING = """new Promise((done) => {
  const { scene, tools } = viewer();
  Object.assign(tools.finer, { quick: QUICK, tired: !QUICK });
  scene.wake();
  setTimeout(() => {
    scene.wake();
    const { frame } = scene.events;
    scene.events.frame = () => {
      // On a busy machine it might come so late that nothing seems to move.
      tools.finer.last = performance.now() - 40;
      frame();
      scene.events.frame = frame;
      const pen = new OffscreenCanvas(WIDTH, HEIGHT).getContext("2d");
      pen.fillRect(0, 0, WIDTH, HEIGHT);  // the page behind it is black
      pen.drawImage(viewer().shadowRoot.querySelector("canvas"), 0, 0);
      const { data } = pen.getImageData(0, 0, WIDTH, HEIGHT);
      done({ width: WIDTH, height: HEIGHT, pixels: bytes(data) });
    };
  }, 40);
})""".replace("WIDTH", str(SIZE[0])).replace("HEIGHT", str(SIZE[1]))
PICTURE = """viewer().picture().then(createImageBitmap).then((found) => {
  const { width, height } = found;
  const pen = new OffscreenCanvas(width, height).getContext("2d");
  pen.drawImage(found, 0, 0);
  return { width, height, pixels: bytes(pen.getImageData(0, 0, width, height).data) };
})"""


def trained_at(times: float) -> LevelSet:
    """Surfaces of small Gaussians whose photos had `times` the focal length of pictures here."""
    plain = bright_levels()
    plain.shared.log_scales[:, 3:] -= 1.3
    for level in plain.levels:
        level.networks["opacity_b2"][:] += 2
    return replace(plain, meta={FOCALS_NOTE: focals_text([(times * 205.0, times * 210.0)] * 4)})


def reduced(levels: LevelSet, camera: Camera, times: int) -> NDArray[np.float64]:
    """Level 3 drawn that many times larger, then the mean of each square."""
    width, height = camera.width, camera.height
    large = camera.resized(times * width, times * height)
    return drawn_by_cpu(levels, large)[3].reshape(height, times, width, times, 3).mean(axis=(1, 3))


@pytest.mark.parametrize(("focal", "times"), [(1.0, 1), (2.0, 2), (4.5, 4)])
def test_what_stands_still_is_drawn_as_large_as_in_training(
    focal: float, times: int, tmp_path: Path
) -> None:
    levels = trained_at(focal)
    camera = camera_of(levels)
    file = tmp_path / "small.gsyn"
    file.write_bytes(encode(levels, "raw"))
    steps: list[dict[str, Any]] = [
        *READY,
        {"name": "_", "script": f"viewer().scene.setPinhole({pinhole(camera)})"},
        {"name": "rest", "script": "atRest(0)"},
        {"name": "saved", "script": PICTURE},
        {"name": "slow", "script": MOVING.replace("QUICK", "false")},
        {"name": "quick", "script": MOVING.replace("QUICK", "true")},
        {"name": "again", "script": "atRest(0)"},
    ]
    with pages(file) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=AT_REST)
    fine = reduced(levels, camera, times)
    coarse = drawn_by_cpu(levels, camera)[3]
    better = psnr(coarse, fine) + 3 if times > 1 else LEAST_DB
    assert better <= LEAST_DB + 3
    for name in ("rest", "again", "saved", "quick"):
        assert psnr(pixels(found.results[name]), fine) >= better, name
    assert psnr(pixels(found.results["slow"]), coarse) >= LEAST_DB
    assert not found.times("error")
