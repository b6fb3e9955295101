"""Scenes and orders out of the ordinary: a finished training always leaves a file that is valid."""

import dataclasses
import json
import shutil
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.robust.examples import transforms
from gsynopsis import __main__ as program
from gsynopsis import cli
from gsynopsis.container import check_file
from gsynopsis.jobs.train_run import MIB, size_notes
from gsynopsis.scene.colmap.binary import read_binary, write_binary
from gsynopsis.synthetic.make_scene import make_scene

WORDS = ("--steps", "4", "--set", "model.slots=4", "model.hidden=8", "--no-evaluate")
Edit = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scenes") / "room"
    return make_scene("room", out, views=9, width=24, height=16, points=150)


def with_points(room: Path, out: Path, edit: Edit) -> Path:
    """The same photos with other points."""
    shutil.copytree(room, out)
    model = read_binary(out / "sparse" / "0")
    points = edit(model.points.copy())
    model = dataclasses.replace(model, points=points, colors=model.colors[: len(points)])
    write_binary(out / "sparse" / "0", model)
    return out


def train(scene: Path, run: Path, *words: str) -> list[int]:
    """Slots of the levels that a training leaves."""
    assert cli.main(["train", str(scene), "--out", str(run), *WORDS, *words]) == 0
    levels = check_file(run / "scene.gsyn").levels
    assert not (run / "training.lock").exists()
    return [level.live for level in levels]


def moved(points: np.ndarray) -> np.ndarray:
    points[0] = 1e9
    return points


@pytest.mark.parametrize(
    "edit",
    [
        lambda points: points[:1],
        lambda points: points[:2],
        lambda points: points[:3],
        lambda points: np.repeat(points[:1], 150, axis=0),
        lambda points: points * [1, 0, 0],
        moved,
    ],
    ids=["one", "two", "three", "equal", "line", "far"],
)
@pytest.mark.parametrize("mode", ["joint", "sequential"])
def test_few_or_odd_points_give_a_whole_file(
    room: Path, tmp_path: Path, edit: Edit, mode: str
) -> None:
    scene = with_points(room, tmp_path / "scene", edit)
    assert len(train(scene, tmp_path / "run", "--levels", mode)) == 4


@pytest.mark.parametrize(
    "sizes",
    [("0.02", "0.04", "0.07", "5"), ("0.0001", "0.0002", "0.0003"), ("1", "2")],
    ids=["large", "small", "two"],
)
def test_levels_without_new_anchors_are_packed_and_told(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], sizes: tuple[str, ...]
) -> None:
    slots = train(room, tmp_path / "run", "--level-mib", *sizes)
    assert len(slots) == len(sizes) and slots == sorted(slots)
    told = [line for line in capsys.readouterr().err.splitlines() if "levels: " in line]
    assert 1 <= len(told) <= 2 and f"L{len(sizes) - 1}" in told[0]


@pytest.mark.parametrize("mode", ["joint", "sequential"])
def test_keeping_all_anchors_gives_levels_that_differ_in_slots_at_most(
    room: Path, tmp_path: Path, mode: str
) -> None:
    slots = train(room, tmp_path / "run", "--keep", "1", "1", "1", "--levels", mode)
    assert len(slots) == 4
    levels = check_file(tmp_path / "run" / "scene.gsyn").levels
    assert len({level.anchors for level in levels}) == 1


def level(number: int, size: float, slots: int) -> Any:
    return SimpleNamespace(level=number, bytes=round(size * MIB), slots=slots)


def test_sizes_that_are_not_the_ordered_ones_are_told_in_a_line_each() -> None:
    levels = [level(0, 0.2, 10), level(1, 0.3, 20), level(2, 0.3, 20)]
    order = [round(size * MIB) for size in (0.1, 0.3, 0.7)]
    small, large, same = size_notes(levels, order)
    assert small.endswith("below target, all anchors used: L2 0.3 MiB instead of 0.7")
    assert large.endswith("above target, minimum reached: L0 0.2 MiB instead of 0.1")
    assert same.endswith("beyond the level below: L2")
    assert size_notes(levels[:2], order[:0]) == []
    assert size_notes([level(0, 0.099, 1), level(1, 0.302, 2)], order[:2]) == []


def test_a_truncated_held_out_photo_is_refused_before_training(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene"
    shutil.copytree(room, scene)
    first = scene / "images" / "view_0000.png"  # held out: number 0 of every 8
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (16, 24, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(first, "JPEG", quality=95)
    assert cli.main(["train", str(scene), "--out", str(tmp_path / "whole"), *WORDS]) == 0
    first.write_bytes(first.read_bytes()[:-400])
    capsys.readouterr()
    run = tmp_path / "run"
    assert cli.main(["train", str(scene), "--out", str(run), *WORDS, "--quiet"]) == 2
    error = capsys.readouterr().err
    assert "view_0000.png: pixels: found " in error and error.count("\n") == 1
    assert not list(run.iterdir())


def test_the_account_stands_before_training_and_in_the_report(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, run = shutil.copytree(room, tmp_path / "scene"), tmp_path / "run"
    (scene / "images" / "view_0003.png").unlink()
    (scene / "images" / "view_0003.HEIC").write_bytes(b"")
    order = [word for word in WORDS if word != "--no-evaluate"]
    assert cli.main(["train", str(scene), "--out", str(run), *order]) == 0
    line = "8 of 9 photos used, poses of sparse/0; 1 not on disk (view_0003.png); "
    line += "not looked at: 1 .heic (convert photos to JPEG or PNG, HEIC by heif-convert or on "
    line += "the phone itself); "
    line += "held out by rule every8; masks: none"
    assert capsys.readouterr().err.splitlines().count(line) == 1
    assert f"<dd>{line}</dd>" in (run / "report.html").read_text("utf-8")
    account = json.loads((run / "metrics.json").read_text("utf-8"))["account"]
    assert account["left_out"] == {"not on disk": ["view_0003.png"]}
    again = ["train", str(scene), "--out", str(tmp_path / "again"), *WORDS, "--json"]
    assert cli.main(again) == 0
    plan = json.loads(capsys.readouterr().err.splitlines()[0])
    assert plan["account"] == account


def test_a_batch_of_more_views_than_there_are_is_refused(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", str(room), "--out", str(tmp_path / "run"), *WORDS, "--batch", "1000"]
    assert cli.main(words) == 2
    assert "--batch: found 1000, expected at most the 7 photos" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["cameras.txt", "images.txt", "points3D.txt"])
def test_a_count_of_five_thousand_digits_is_one_line(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    scene = tmp_path / "scene"
    (scene / "sparse" / "0").mkdir(parents=True)
    texts = {
        "cameras.txt": "1 PINHOLE 24 16 20 20 12 8\n",
        "images.txt": "1 1 0 0 0 0 0 0 1 a.png\n\n",
        "points3D.txt": "1 0 0 0 1 1 1 0\n",
    }
    kind = name.partition(".")[0].removesuffix("3D")
    texts[name] = f"# Number of {kind}: {'9' * 5000}\n{texts[name]}"
    for each, text in texts.items():
        (scene / "sparse" / "0" / each).write_text(text)
    assert cli.main(["train", str(scene), "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert f"{name}: count: found 5000 digits, expected at most 18" in error
    assert error.count("\n") == 1


def test_a_warning_of_numpy_is_no_line_of_ours_unless_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A focal length near zero overflows on the way to the error that it ends in."""
    transforms(tmp_path)
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"fl_x": 1e-320}))
    line = ["gsynopsis", "train", str(tmp_path), "--out", str(tmp_path / "run"), "--quiet"]
    monkeypatch.setattr(sys, "argv", line)

    def printed(message: Warning, category: type[Warning], *place: Any) -> None:
        """To stderr, as Python does and pytest does not."""
        print(warnings.formatwarning(message, category, *place[:2]), file=sys.stderr)

    before = signal.getsignal(signal.SIGTERM)
    # As a process begins, and one of `python -W default`.
    for asked in ([], ["default"]):
        monkeypatch.setattr(sys, "warnoptions", asked)
        with warnings.catch_warnings():
            warnings.resetwarnings()
            warnings.simplefilter("default")
            monkeypatch.setattr(warnings, "showwarning", printed)
            assert program.main() == 2
        said = capsys.readouterr().err
        assert "camera distortion: found a lens that folds" in said
        assert (len(said.splitlines()) == 1) == (not asked)
        assert ("RuntimeWarning: overflow" in said) == bool(asked)
    signal.signal(signal.SIGTERM, before)
