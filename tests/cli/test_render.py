"""`render` and `evaluate` from the outside, with a decoder and a renderer that are known."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from PIL.GifImagePlugin import GifImageFile

from gsynopsis import cli
from gsynopsis.cameras.orbit import Circle, orbit
from gsynopsis.cli import bounds, flight
from gsynopsis.cli.render import flat_names
from gsynopsis.container import read_gsyn, write_gsyn
from gsynopsis.errors import GsynopsisError
from gsynopsis.evaluation import load_model as opening
from gsynopsis.evaluation.load_model import Opened
from gsynopsis.evaluation.metrics import PSNR_CAP
from gsynopsis.jobs import evaluate as evaluation
from gsynopsis.scene import load as scene_room
from gsynopsis.scene.camera import Camera
from tests.evaluation.test_lpips import made_up
from tests.stage import FakeScene, LevelDecoder, fake_scene, level_set, renderer_of

NOISE = (0.2, 0.1, 0.04, 0.0)


@pytest.fixture
def scene() -> FakeScene:
    return fake_scene()


@pytest.fixture
def run_folder(tmp_path: Path, scene: FakeScene, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run whose model and photos are fakes, while file and record are real."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_gsyn(level_set(), folder / "scene.gsyn")
    record = {"scene": "../photos", "scale": 2, "preset": "standard", "seed": 1, "steps": 9}
    (folder / "run.json").write_text(json.dumps(record | {"train_seconds": 3.5}))

    def opened(file: Path, backend: str) -> Opened:
        assert backend == "auto"
        return Opened(read_gsyn(file), LevelDecoder(NOISE), renderer_of(scene))

    monkeypatch.setattr(opening, "open_levels", opened)
    monkeypatch.setattr(evaluation, "open_levels", opened)
    monkeypatch.setattr(evaluation, "load_scene", lambda path, split, *reading: scene)
    monkeypatch.setattr(scene_room, "load_scene", lambda path, split, *reading: scene)
    return folder


def pixels_of(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


def test_evaluate_writes_everything_and_prints_the_table(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["evaluate", str(run_folder), "--frames", "2"]) == 0
    text = capsys.readouterr().out
    assert text.splitlines()[0].split() == ["level", "anchors", "MiB", "dB", "ms"]
    assert "dB: PSNR of" in text
    for name in ("metrics.json", "metrics.csv", "views.csv", "contact.png", "report.html"):
        assert str(run_folder / name) in text
        assert (run_folder / name).stat().st_size > 0


def test_evaluate_json_prints_exactly_the_file(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "elsewhere"
    command = ["evaluate", str(run_folder), "--json", "--frames", "2", "--out", str(out)]
    assert cli.main(command) == 0
    text = capsys.readouterr().out
    assert text == (out / "metrics.json").read_text("utf-8")
    metrics = json.loads(text)
    assert [metrics[k] for k in ("preset", "seed", "steps", "scale")] == ["standard", 1, 9, 2.0]
    assert not (run_folder / "metrics.json").exists()


def test_evaluate_measures_lpips_by_the_weights_of_the_user(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.save(made_up("alex"), tmp_path / "alex.pt")
    words = ["--lpips", str(tmp_path / "alex.pt"), "--json", "--frames", "1"]
    assert cli.main(["evaluate", str(run_folder), *words]) == 0
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["lpips"] == "lpips alex [-1,1]"
    figures = [(level["psnr_full"], level["lpips_full"]) for level in metrics["levels"]]
    assert all((lpips > 0) == (psnr < PSNR_CAP) for psnr, lpips in figures), figures


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--frames", "0"], "--frames: found 0"),
        (["--scale", "0"], "--scale: found 0"),
        (["--scale", "nan"], "--scale: found nan"),
        (["--lpips", "nowhere.pt"], "--lpips: found nowhere.pt: No such file"),
    ],
)
def test_evaluate_refuses_what_cannot_be(
    run_folder: Path, words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["evaluate", str(run_folder), *words]) == 2
    assert text in capsys.readouterr().err
    assert sorted(p.name for p in run_folder.iterdir()) == ["run.json", "scene.gsyn"]


def test_render_draws_the_held_out_views_of_a_run(
    run_folder: Path, tmp_path: Path, scene: FakeScene
) -> None:
    assert cli.main(["render", str(run_folder), "--out", str(tmp_path / "out")]) == 0
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["view_00_L3.png", "view_04_L3.png", "view_08_L3.png"]
    picture = pixels_of(tmp_path / "out" / "view_04_L3.png")
    assert np.array_equal(picture, scene.image(4, 2.0))


def test_render_draws_the_level_and_size_that_were_asked_for(
    run_folder: Path, tmp_path: Path, scene: FakeScene
) -> None:
    out = tmp_path / "out"
    words = ["--level", "1", "--views", "all", "--width", "48"]
    assert cli.main(["render", str(run_folder), "--out", str(out), *words]) == 0
    assert len(list(out.iterdir())) == len(scene.views)
    picture = pixels_of(out / "view_02_L1.png").astype(int)
    assert picture.shape == (32, 48, 3)
    truth = scene.image(2, 2.0).astype(int)
    # 0.1 is 25.5 of 255: rounding may go either way.
    assert np.abs(picture - np.minimum(truth + 25.5, 255)).max() <= 0.5


def test_render_without_a_scene_flies_around_the_frame(run_folder: Path, tmp_path: Path) -> None:
    out, file = tmp_path / "out", run_folder / "scene.gsyn"
    words = ["--orbit", "3", "--width", "32", "--height", "18"]
    assert cli.main(["render", str(file), "--out", str(out), *words]) == 0
    names = sorted(p.name for p in out.iterdir())
    assert names == [f"orbit_000{i}_L3.png" for i in range(3)]
    with Image.open(out / names[0]) as picture:
        assert picture.size == (32, 18)


@pytest.mark.parametrize("more", [[], ["--all-round"]])
def test_an_orbit_stays_where_photos_were_taken_unless_all_round_is_asked_for(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: list[str]
) -> None:
    flown: list[Circle] = []

    def watch(circle: Circle, lens: Camera, count: int) -> list[Camera]:
        flown.append(circle)
        return orbit(circle, lens, count)

    monkeypatch.setattr("gsynopsis.cli.render.orbit", watch)
    words = ["--orbit", "2", "--width", "32", "--out", str(tmp_path / "out")]
    assert cli.main(["render", str(run_folder), *words, *more]) == 0
    (circle,) = flown
    assert (circle.arc is None) == bool(more)


def test_a_flight_is_a_looping_gif_of_all_frames(run_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "new" / "flight.gif"
    words = ["--orbit", "5", "--fps", "10", "--flight", str(path)]
    assert cli.main(["render", str(run_folder), *words]) == 0
    with GifImageFile(path) as movie:
        assert movie.size == (48, 32)
        assert movie.n_frames == 5
        assert movie.info["duration"] == 100
        assert movie.info["loop"] == 0
    assert [p.name for p in path.parent.iterdir()] == ["flight.gif"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "--out: found nothing"),
        (["--out", "x", "--level", "4"], "--level: found 4, expected 0 to 3"),
        (["--out", "x", "--level", "-1"], "--level: found -1"),
        (["--out", "x", "--orbit", "0"], "--orbit: found 0"),
        (["--out", "x", "--views", "all", "--orbit", "3"], "one of the two"),
        (["--flight", "x.avi"], ".gif or .mp4"),
        (["--out", "x", "--fps", "inf"], "--fps: found inf"),
        (["--out", "x", "--scale", "0"], "--scale: found 0"),
    ],
)
def test_render_refuses_what_cannot_be_in_one_line(
    run_folder: Path,
    words: list[str],
    text: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(run_folder.parent)
    assert cli.main(["render", str(run_folder), *words]) == 2
    line = capsys.readouterr().err
    assert text in line
    assert line.count("\n") == 1
    assert not Path("x").exists()


def test_mp4_without_ffmpeg_names_the_gif(
    run_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight.shutil, "which", lambda name: None)
    assert cli.main(["render", str(run_folder), "--flight", "a.mp4"]) == 2
    line = capsys.readouterr().err
    assert "ffmpeg" in line
    assert "--flight a.gif" in line


def fake_ffmpeg(folder: Path, body: str, monkeypatch: pytest.MonkeyPatch) -> None:
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{body}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")


def test_mp4_gives_ffmpeg_even_raw_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_ffmpeg(tmp_path, 'for last; do :; done; wc -c > "$last"', monkeypatch)
    frames = [np.zeros((7, 9, 3), np.uint8)] * 4
    flight.write_flight(frames, tmp_path / "a.mp4", 24.0)
    assert int((tmp_path / "a.mp4").read_text()) == 4 * 6 * 8 * 3


def test_a_failing_ffmpeg_is_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_ffmpeg(tmp_path, "cat > /dev/null; echo no codec >&2; exit 3", monkeypatch)
    with pytest.raises(GsynopsisError, match=r"the flight: no codec"):
        flight.write_flight([np.zeros((8, 8, 3), np.uint8)], tmp_path / "a.mp4", 24.0)
    assert [p.name for p in tmp_path.iterdir()] == ["ffmpeg"]


def test_a_damaged_file_is_refused_before_torch_is_asked_for(tmp_path: Path) -> None:
    bad = tmp_path / "bad.gsyn"
    bad.write_bytes(b"not a file of ours")
    assert cli.main(["render", str(bad), "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()
    assert bounds.positive("--x", 1.5) == 1.5


def test_pictures_of_photos_whose_names_become_alike_do_not_replace_each_other() -> None:
    names = ["a/b.png", "a_b.png", "a_b.jpg", "A_B.jpg", "a_b_2.png", "c.png", ".png"]
    found = flat_names(names)
    assert found[0] == "a_b" and found[5:] == ["c", ".png"]
    assert len({name.lower() for name in found}) == len(names)
    assert found[4] == "a_b_2", "a name of its own stays"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--width", "100000"], "--width: found 100000, expected 1 to 8,192"),
        (["--height", "0"], "--height: found 0, expected 1 to 8,192"),
        (["--width", "8192", "--height", "8193"], "--height: found 8193"),
        (["--orbit", "99999999999"], "--orbit: found 99999999999, expected 1 to 100,000"),
        (["--fps", "1e-9"], "--fps: found 1e-09, expected 0.02 to 1,000"),
        (["--fps", "nan"], "--fps: found nan"),
        (["--views", "test", "--scale", "1e-3"], "width of a picture: found 96000"),
    ],
)
def test_render_refuses_pictures_that_no_memory_holds(
    run_folder: Path, tmp_path: Path, words: list[str], expected: str, capsys
) -> None:
    assert cli.main(["render", str(run_folder), "--out", str(tmp_path / "out"), *words]) == 2
    error = capsys.readouterr().err
    assert expected in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
