"""Frames of a video: the sharpest of each stretch of camera motion."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from gsynopsis import cli
from gsynopsis.errors import SceneError
from gsynopsis.scene import video
from gsynopsis.scene.video import Footage, choose, digest_of, is_video, look_at, take_frames
from tests.scene.films import FFMPEG, film, needs_ffmpeg

STILL, MOVING, STEP = 12, 48, 4
"""Frames of each part; pixels of motion from one to the next."""
WIDTH, HEIGHT = 240, 160


def panned() -> list[NDArray[np.uint8]]:
    """A camera that stands and then pans over a wall; two of three frames are blurred.

    The exposure rolls: it makes the light neither motion nor sharpness.
    """
    rng = np.random.default_rng(0)
    wall = Image.fromarray(rng.integers(0, 256, (80, 300, 3)).astype(np.uint8))
    wall = wall.resize((WIDTH + 4 * MOVING * STEP, 2 * HEIGHT), Image.Resampling.BICUBIC)
    frames: list[NDArray[np.uint8]] = []
    for n in range(STILL + MOVING):
        x = max(0, n - STILL + 1) * STEP
        frame = wall.crop((x, 40, x + WIDTH, 40 + HEIGHT))
        if n % 3:
            frame = frame.filter(ImageFilter.BoxBlur(3))
        light = 0.7 + 0.3 * np.sin(n / 5)
        frames.append(np.rint(np.asarray(frame) * light).astype(np.uint8))
    return frames


@pytest.fixture(scope="module")
def pan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if FFMPEG is None:
        pytest.skip("no ffmpeg: video NOT tested")
    return film(panned(), tmp_path_factory.mktemp("film") / "Pan.MP4")


def quiet(done: int, total: int) -> None:
    assert 0 < done <= total


def test_motion_is_the_cameras_and_not_that_of_the_light(pan: Path) -> None:
    seen = look_at(str(FFMPEG), pan, quiet)
    assert len(seen.places) == STILL + MOVING
    assert seen.places[STILL - 1] == 0
    # Shifts are whole pixels of copies a quarter as large.
    assert seen.places[-1] * WIDTH == pytest.approx(MOVING * STEP, abs=8)


def test_the_sharpest_frame_of_each_stretch_is_taken(pan: Path, tmp_path: Path) -> None:
    seen = look_at(str(FFMPEG), pan, quiet)
    chosen = choose(seen, 12)
    assert len(chosen) == 12 and not [n for n in chosen if n % 3]
    assert sum(n < STILL for n in chosen) <= 2, "where nothing moves, few are taken"
    told: list[tuple[int, int]] = []
    said = take_frames(
        pan, digest_of(pan), tmp_path / "frames", 12, lambda *step: told.append(step)
    )
    assert said.startswith("12 of 60 frames of Pan.MP4 taken")
    assert told[-1] == (60, 60) and all(done < total for done, total in told[:-1])
    paths = sorted(path for path in (tmp_path / "frames").iterdir() if path.suffix == ".jpg")
    assert [path.name for path in paths] == [f"frame_{n:04d}.jpg" for n in range(1, 13)]
    truth = np.stack(panned()).astype(np.float32)
    for number, path in zip(chosen, paths, strict=True):
        with Image.open(path) as photo:
            off = ((np.asarray(photo, np.float32) - truth) ** 2).mean(axis=(1, 2, 3))
        nearest = np.flatnonzero(off <= 1.01 * off.min())
        assert number in nearest, "the frame that was chosen"


def test_frames_of_the_same_video_are_not_taken_again(
    pan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = take_frames(pan, digest_of(pan), tmp_path / "frames", 8, quiet)

    def refused(*_: object) -> Footage:
        raise AssertionError("looked at again")

    monkeypatch.setattr(video, "look_at", refused)
    assert take_frames(pan, digest_of(pan), tmp_path / "frames", 8, quiet) == said
    with pytest.raises(AssertionError, match="looked at again"):
        take_frames(pan, digest_of(pan), tmp_path / "frames", 9, quiet)


@given(
    steps=st.lists(st.floats(0, 0.2), min_size=3, max_size=60),
    most=st.integers(3, 50),
    seed=st.integers(0, 99),
)
def test_chosen_frames_rise_and_are_no_more_than_asked(
    steps: list[float], most: int, seed: int
) -> None:
    places = np.cumsum(steps) - steps[0]
    sharpness = np.random.default_rng(seed).uniform(size=len(steps))
    chosen = choose(Footage(places, sharpness), most)
    assert chosen == sorted(set(chosen)) and 0 < len(chosen) <= min(most, len(steps))
    assert int(sharpness.argmax()) in chosen


def test_a_stretch_that_has_blurred_frames_alone_gives_none() -> None:
    """Of ten stretches of three frames the fifth; one of which all are blurred keeps them."""
    places, sharpness = np.linspace(0, 1, 30), np.ones(30)
    sharpness[12:15] = 0.4
    assert [n // 3 for n in choose(Footage(places, sharpness), 10)] == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert len(choose(Footage(places, 0.4 * np.ones(30)), 10)) == 10


def test_without_ffmpeg_a_video_is_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.mp4").write_bytes(b"a video")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for line in (["scene", "a.mp4", "out"], ["train", "a.mp4", "--out", "out"]):
        monkeypatch.chdir(tmp_path)
        assert cli.main([*line, "--quiet"]) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert "a.mp4: found a video and no program ffmpeg, expected one on PATH; install" in said
        assert not (tmp_path / "out" / "scene").exists()
        assert not (tmp_path / "out" / "sfm").exists()


@needs_ffmpeg
def test_a_damaged_video_and_one_of_two_frames_are_one_line_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pycolmap")
    damaged = tmp_path / "a.mov"
    damaged.write_bytes(b"no video at all")
    assert is_video(damaged) and not is_video(tmp_path / "b.mov")
    assert cli.main(["scene", str(damaged), str(tmp_path / "out"), "--quiet"]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "a.mov: found no picture (ffmpeg: " in said and "a video that ffmpeg can decode" in said
    assert not (tmp_path / "out").exists()
    short = film(panned()[:2], tmp_path / "short.avi")
    with pytest.raises(SceneError, match=r"short\.avi: found 2 frames, expected at least 3"):
        take_frames(short, digest_of(short), tmp_path / "frames", 12, quiet)
    assert not (tmp_path / "frames").exists()
