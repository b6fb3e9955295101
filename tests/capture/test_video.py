"""Frames of a video: the sharpest of each stretch of camera motion."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from gsynopsis import cli
from gsynopsis.capture import video
from gsynopsis.capture.photo_set import digest_of
from gsynopsis.capture.video import Footage, choose, is_video, look_at, take_frames
from gsynopsis.errors import SceneError
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


def looked_at(path: Path) -> Footage:
    """All frames of a film."""
    return look_at(str(FFMPEG), path, video.size_of(str(FFMPEG), path), 0, quiet)


def test_motion_is_the_cameras_and_not_that_of_the_light(pan: Path) -> None:
    seen = looked_at(pan)
    assert len(seen.places) == STILL + MOVING
    assert seen.places[STILL - 1] == 0
    # Shifts are whole pixels of copies a quarter as large.
    assert seen.places[-1] * WIDTH == pytest.approx(MOVING * STEP, abs=8)


def test_the_sharpest_frame_of_each_stretch_is_taken(pan: Path, tmp_path: Path) -> None:
    seen = looked_at(pan)
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


def walked(count: int, width: int = WIDTH, height: int = HEIGHT) -> list[NDArray[np.uint8]]:
    """Frames of a pan, each with its number as grey in its corner: 4 a step."""
    rng = np.random.default_rng(1)
    wall = Image.fromarray(rng.integers(0, 256, (40, 200, 3)).astype(np.uint8))
    wall = wall.resize((width + count * STEP, height), Image.Resampling.BICUBIC)
    frames: list[NDArray[np.uint8]] = []
    for n in range(count):
        frame = np.array(wall.crop((n * STEP, 0, n * STEP + width, height)))
        frame[:32, :32] = 4 * n + 8
        frames.append(frame)
    return frames


def numbers_of(folder: Path) -> list[int]:
    """What stands in the corners of photos."""
    found: list[int] = []
    for path in sorted(folder.glob("*.jpg")):
        with Image.open(path) as photo:
            corner = np.asarray(photo)
        h, w = corner.shape[0] * 24 // HEIGHT, corner.shape[1] * 24 // WIDTH
        found.append(round((float(corner[8:h, 8:w].mean()) - 8) / 4))
    return found


UNEVEN = ("-vf", "setpts='if(lt(N,20),N,20+7*(N-20))/30/TB'", "-fps_mode", "passthrough")
"""Frames of 30 a second, then of four."""


@needs_ffmpeg
@pytest.mark.parametrize(
    ("name", "rate", "more"),
    [
        *(("slow.mp4", rate, ()) for rate in ("10", "15", "7/3")),
        ("timelapse.mov", "1/2", ()),
        ("phone.mp4", "30", UNEVEN),
        ("late.mkv", "30", ("-output_ts_offset", "7")),
        ("early.ts", "24", ("-output_ts_offset", "-1", "-c:v", "mpeg2video")),
        ("old.avi", "9", ()),
    ],
)
def test_each_frame_comes_once_whatever_its_time(
    tmp_path: Path, name: str, rate: str, more: tuple[str, ...]
) -> None:
    if "-c:v" in more:
        rate = "25"
    path = film(walked(40), tmp_path / name, rate, more)
    seen = looked_at(path)
    assert len(seen.places) == 40
    take_frames(path, digest_of(path), tmp_path / "frames", 13, quiet)
    assert numbers_of(tmp_path / "frames") == choose(seen, 13)


@needs_ffmpeg
def test_a_video_that_changes_its_size_and_form_on_the_way_is_counted_on(tmp_path: Path) -> None:
    """ffmpeg began its filters again, and their count of frames."""
    plain, clips = ("-c:v", "mpeg2video"), list[bytes]()
    frames, large = walked(45), [np.repeat(np.repeat(f, 2, 0), 2, 1) for f in walked(45)]
    for number, (part, more) in enumerate(
        [
            (frames[:15], plain),
            (large[15:30], plain),
            (frames[30:], (*plain, "-pix_fmt", "yuv422p")),
        ]
    ):
        clip = film(part, tmp_path / f"{number}.ts", "25", more)
        clips.append(clip.read_bytes())
    path = tmp_path / "whole.ts"
    path.write_bytes(b"".join(clips))
    seen = looked_at(path)
    take_frames(path, digest_of(path), tmp_path / "frames", 16, quiet)
    chosen = choose(seen, 16)
    assert max(chosen) > 30 and len(seen.places) in {43, 44, 45}
    # A decoder may drop the last frame of a clip: the corner says which one a frame was.
    found = numbers_of(tmp_path / "frames")
    assert len(found) == len(chosen) == len(set(found)) and found == sorted(found)
    assert all(0 <= told - number <= 2 for told, number in zip(found, chosen, strict=True))


@needs_ffmpeg
def test_an_older_program_is_asked_in_its_own_words_and_one_that_repeats_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = film(walked(20), tmp_path / "a b.mp4", "10")
    for name, text in {
        "older": '[ "$*" = "-h long" ] && echo -vsync && exit\n'
        'case "$*" in *-fps_mode*) exit 1;; esac\n',
        "doubled": '[ "$*" = "-h long" ] && echo -vsync && exit\n'
        'for a; do case $a in passthrough) a=cfr;; -frames:v) one=y;; esac; set -- "$@" "$a"; '
        'shift; done\n[ "$one" ] || set -- "${@:1:$#-1}" -r 25 -\n',
    }.items():
        program = tmp_path / name
        # ffmpeg 9 no longer knows the older word.
        newer = 'for a; do [ "$a" = -vsync ] && a=-fps_mode; set -- "$@" "$a"; shift; done\n'
        program.write_text(f'#!/bin/bash\n{text}{newer}exec {FFMPEG} "$@"\n')
        program.chmod(0o755)
        monkeypatch.setattr(video, "find_ffmpeg", lambda _, program=program: str(program))
        if name == "older":
            take_frames(path, digest_of(path), tmp_path / "out", 5, quiet)
            continue
        with pytest.raises(SceneError, match=r"a b\.mp4: found other frames when read again"):
            take_frames(path, digest_of(path), tmp_path / "frames", 5, quiet)
        assert not [p for p in tmp_path.iterdir() if "frames" in p.name]


MANIFEST = """<?xml version="1.0"?>
<MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static" mediaPresentationDuration="PT2S"
 profiles="urn:mpeg:dash:profile:isoff-on-demand:2011"><Period><AdaptationSet mimeType="video/mp4">
<Representation id="1" bandwidth="1000" width="240" height="160"><BaseURL>../secret/private.mp4
</BaseURL></Representation></AdaptationSet></Period></MPD>"""
SCRIPT = "ffconcat version 1.0\nfile 'private.mp4'\n"
PLAYLIST = "#EXTM3U\n#EXT-X-TARGETDURATION:4\n#EXTINF:4,\nprivate.mp4\n#EXT-X-ENDLIST\n"
DESCRIBED = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\n"


@needs_ffmpeg
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x.mp4", MANIFEST.replace("\n</Base", "</Base")),
        ("x.mp4", MANIFEST.replace("../secret/private.mp4\n", "private.mp4")),
        ("x.mov", SCRIPT),
        ("x.mkv", PLAYLIST),
        ("x.webm", DESCRIBED),
    ],
)
def test_a_text_named_like_a_video_makes_nothing_of_other_files(
    tmp_path: Path, name: str, text: str
) -> None:
    private = film(walked(10), tmp_path / "private.mp4")
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "private.mp4").write_bytes(private.read_bytes())
    (tmp_path / name).write_text(text)
    with pytest.raises(SceneError, match=r"found no picture \(ffmpeg: .*a video that ffmpeg can"):
        take_frames(tmp_path / name, "digest", tmp_path / "frames", 5, quiet)
    assert not (tmp_path / "frames").exists()


def has_encoder(name: str) -> bool:
    line = [str(FFMPEG), "-hide_banner", "-encoders"]
    return FFMPEG is not None and name in subprocess.run(line, capture_output=True).stdout.decode()


@pytest.mark.skipif(not has_encoder("libx265"), reason="no libx265: HLG and PQ NOT tested")
@pytest.mark.parametrize(("transfer", "short"), [("arib-std-b67", "HLG"), ("smpte2084", "PQ")])
def test_light_beyond_a_screen_is_mapped_and_said(
    tmp_path: Path, transfer: str, short: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """White paper of 203 cd/m² and colours below it come back nearly as they were."""
    frames = walked(12)
    for frame in frames:
        for x, color in enumerate(([40, 40, 40], [120, 60, 40], [40, 110, 60], [50, 60, 130])):
            frame[64:, 60 * x : 60 * x + 60] = color
    graded = (
        f"format=gbrp,zscale=tin=bt709:pin=bt709:rangein=full:t={transfer}:npl=203"
        ":p=2020:m=2020_ncl:r=tv,format=yuv420p10le"
    )
    more = ("-vf", graded, "-c:v", "libx265", "-x265-params", "log-level=none:qp=4", "-an")
    path = film(frames, tmp_path / "sunset.mp4", "30", more)
    said = take_frames(path, digest_of(path), tmp_path / "frames", 4, quiet)
    assert said.endswith(f"; {short} video: tone-mapped to sRGB")
    with Image.open(tmp_path / "frames" / "frame_0001.jpg") as photo:
        pixels = np.asarray(photo).astype(float)
    for x in range(4):
        shown = pixels[80:-16, 60 * x + 12 : 60 * x + 48].mean(axis=(0, 1))
        np.testing.assert_allclose(shown, frames[0][100, 60 * x + 30], atol=12)
    said_of = video._said

    def without(program: str, *options: str) -> str:
        return "" if options == ("-filters",) else said_of(program, *options)

    monkeypatch.setattr(video, "_said", without)
    said = take_frames(path, digest_of(path), tmp_path / "frames", 5, quiet)
    assert f"it is {short} video, and colours stay as stored" in said


@needs_ffmpeg
def test_a_title_that_names_a_transfer_function_is_no_transfer_function(tmp_path: Path) -> None:
    more = ("-metadata", "title=smpte2084", "-metadata:s:v:0", "title=arib-std-b67")
    path = film(walked(5), tmp_path / "a.mkv", "30", more)
    assert video.transfer_of(video.description_of(str(FFMPEG), path)) == ""
