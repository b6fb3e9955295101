"""A film of a room, as a phone takes it, goes to a browser by one command.

The exposure rolls, every eighth frame is blurred by motion, and nobody knows the poses.
"""

import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from benchmarks.viewer.browser import MISSING, pinhole, pixels, psnr, visit
from gsynopsis.container import check_file
from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.scene.load import load_scene
from gsynopsis.synthetic import room
from gsynopsis.synthetic.make_scene import FOCAL, UP
from gsynopsis.synthetic.raytracer import render
from tests.scene.films import FFMPEG, film

pytest.importorskip("pycolmap", reason="pycolmap is not installed: capture NOT tested")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: capture NOT seen in a browser"),
]
FRAMES, WIDTH, HEIGHT = 32, 320, 240
ARC = 0.93
"""Radians around the room: half as far between frames as between those that are taken."""
BLURRED = 8
"""Every so many frames one is blurred."""
BLUR = 10
"""Pixels that the picture moves while its shutter is open."""
LEAST_DB = 17.0
"""Of the browser's picture beside a photo while training runs; another view is below 14 dB."""
# So long that a scene of after the 250th step is shown even beside other work. No longer than that:
# nothing is asked of what the levels gain by steps of their own.
WORDS = ("--scale", "2", "--steps", "500", "--viewer", "--viewer-port", "0")
WORDS += ("--set", "levels.steps=250")
# 5 % of the time goes into what is shown, so a slow packing would keep the next one waiting for
# most of a minute: the command as it is, but that it shows more often.
START = """
from gsynopsis.monitor import live_page
live_page.SHARE = 0.5
from gsynopsis.__main__ import main
raise SystemExit(main())
"""
ADDRESS = re.compile(r"(http://\S+) shows the training")


@cache
def frames() -> list[NDArray[np.uint8]]:
    """Part of the way round the room, with a hand that sways."""
    world, taken = room.world(0), list[NDArray[np.uint8]]()
    focal = FOCAL * WIDTH
    for n, angle in enumerate(np.arange(FRAMES) * (ARC / FRAMES)):
        place = [room.ORBIT * np.cos(angle), room.ORBIT * np.sin(angle), 1.5 + 0.3 * np.sin(angle)]
        target = np.array([0.1 * np.sin(3 * angle), 0.1 * np.cos(2 * angle), 0.9])
        w2c = look_at(np.array(place), target, UP)
        frame = render(world, Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, w2c))
        seen = frame.astype(np.float64)
        if n % BLURRED == 0:
            seen = np.mean([np.roll(seen, shift, axis=1) for shift in range(BLUR)], axis=0)
        light = (1 + 0.25 * np.sin(n / 9)) * np.array([1, 1, 1 + 0.08 * np.cos(n / 7)])
        taken.append(np.rint((seen * light).clip(0, 255)).astype(np.uint8))
    return taken


def sources(photos: Path) -> list[int]:
    """Which of the frames each photo is: the nearest in its pixels, the blurred ones among them."""
    films = np.stack([frame[::4, ::4].astype(np.float64) for frame in frames()])
    found = []
    for path in sorted(photos.iterdir()):
        photo = Image.open(path).resize((WIDTH, HEIGHT))
        pixels_ = np.asarray(photo)[::4, ::4].astype(np.float64)
        found.append(int(((films - pixels_) ** 2).mean((1, 2, 3)).argmin()))
    return found


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film where ffmpeg is there, else its frames in a folder."""
    folder = tmp_path_factory.mktemp("capture")
    if FFMPEG:
        return film(frames(), folder / "room.mp4")
    for number, frame in enumerate(frames()[::2]):
        Image.fromarray(frame).save(folder / f"frame_{number:04d}.png")
    return folder


def test_it_goes_to_the_browser_by_one_command(capture: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = ["train", str(capture), "--out", str(run), *WORDS]
    line = [sys.executable, "-c", START, *words]
    said: list[str] = []
    visit("about:blank", tmp_path, ())  # the browser's own start takes none of the training's time
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as training:
        try:
            assert training.stderr is not None
            for text in training.stderr:
                said.append(text)
                if found := ADDRESS.search(text):
                    break
            else:
                raise AssertionError("".join(said))
            scene = load_scene(run / "scene")
            view = scene.train[len(scene.train) // 2]
            camera = scene.camera(view, 2)
            # The viewer looks now and then: it shows an older version for a while.
            enough = (
                "fetch('/live.json').then((r) => r.json())"
                ".then(({ version }) => version !== null && version.step > 250"
                " && viewer().scene?.facts?.levels.at(-1).end === version.bytes)"
            )
            look = {"name": "picture", "script": f"picture({pinhole(camera)}, null)"}
            steps = [{"until": enough, "timeout": 150_000}, {"wait": "complete"}, look]
            shown = visit(found[1], tmp_path, steps)
            said += training.stderr
            assert training.wait() == 0, "".join(said)
        finally:
            training.kill()
    photo = scene.image(view, 2).astype(np.float64) / 255
    assert psnr(pixels(shown.results["picture"]), photo) >= LEAST_DB
    assert not [line for line in shown.said if line.startswith("pageerror")]
    text = "".join(said)
    assert re.search(r"train\.exposure (on: |off: )photos", text), text
    found = json.loads((run / "scene" / "scene.json").read_text())["found"]
    count = FRAMES // 2
    if FFMPEG:  # of photos none is left out, blurred or not
        taken = re.search(r"(\d+) of 32 frames", text)
        assert taken and 8 <= int(taken[1]) < 27
        assert not [n for n in sources(run / "scene" / "images") if n % BLURRED == 0]
        count = int(taken[1])
    assert len(found["registered"]) >= 0.9 * count, text
    measured = json.loads((run / "metrics.json").read_text())["levels"][-1]
    assert measured["psnr_full"] > 20
    assert len(check_file(run / "scene.gsyn").levels) == 4
