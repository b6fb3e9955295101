"""Photos alone become a scene, also in several goes."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis import cli
from gsynopsis.capture.sfm import Reconstructed
from gsynopsis.container import check_file
from gsynopsis.errors import SceneError, SettingError
from gsynopsis.jobs import estimate_poses as poses
from gsynopsis.jobs.estimate_poses import PoseOptions, PoseReport, estimate_poses
from gsynopsis.scene.load import load_scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.observer import Observer, Silent

pytest.importorskip("pycolmap")
VIEWS, WIDTH, HEIGHT = 24, 240, 180
FEW = PoseOptions(features=2048)


class Told(Silent):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def on_message(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("photos") / "room"
    return make_scene("room", out, views=VIEWS, width=WIDTH, height=HEIGHT, points=100)


@pytest.fixture(scope="module")
def posed(room: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Told]:
    """A scene of photos alone, stopped before each step and gone on with."""
    out, told = tmp_path_factory.mktemp("scenes") / "room", Told()
    steps = ("find_features", "match_features", "map_photos", "undistort", "picture_of")
    for name in steps:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(poses, name, _interrupted)
            with pytest.raises(KeyboardInterrupt):
                estimate_poses(room / "images", out, FEW, told)
        assert (out / "sparse").exists() == (name == steps[-1])
    shutil.copytree(out, unreported(out))
    estimate_poses(room / "images", out, FEW, told)
    return out, told


def unreported(out: Path) -> Path:
    """The folder of that scene as it was before its picture and its report were written."""
    return out.with_name("unreported")


def _interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_the_poses_are_those_of_the_procedural_camera_but_for_a_similarity(
    room: Path, posed: tuple[Path, Told]
) -> None:
    truth, found = load_scene(room), load_scene(posed[0])
    assert [view.name for view in found.views] == [view.name for view in truth.views]
    a = np.stack([view.camera.position for view in found.views])
    b = np.stack([view.camera.position for view in truth.views])
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    left, singular, right = np.linalg.svd(a.T @ b)
    scale = singular.sum() / (a**2).sum()
    off = np.linalg.norm(scale * a @ (left @ right) - b, axis=1)
    # A pixel is a quarter of a percent of the orbit; a wrong pose is off by tens of percents.
    assert off.max() < 0.03 * np.linalg.norm(b, axis=1).max()
    # The world stands upright: the room's z axis is up, and so is the scene's.
    assert np.linalg.det(left @ right) > 0
    assert (left @ right)[2, 2] > 0.99


def test_an_interrupted_scene_goes_on_and_leaves_nothing_but_the_scene(
    posed: tuple[Path, Told],
) -> None:
    out, told = posed
    assert sum(line.startswith("going on with") for line in told.lines) == 5
    names = {path.name for path in out.iterdir()}
    assert names == {"images", "sparse", "scene.json", "scene.png"}


def test_the_report_says_what_was_found(posed: tuple[Path, Told]) -> None:
    values = json.loads((posed[0] / "scene.json").read_text())
    assert values["photos"] == VIEWS and len(values["found"]["registered"]) == VIEWS
    assert values["found"]["mapper"] == "global" and values["found"]["error"] < 1
    steps = {"photos", "keypoints", "matches", "mapping", "upright", "undistortion"}
    assert set(values["seconds"]) == steps
    with Image.open(posed[0] / "scene.png") as picture:
        assert picture.size == (1280, 640)


def test_the_same_command_again_does_nothing_and_other_photos_begin_again(
    room: Path, posed: tuple[Path, Told], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(poses, "find_features", _interrupted)
    report = estimate_poses(room / "images", posed[0], FEW)
    assert len(report.found.registered) == VIEWS and "24 of 24 photos" in report.text()
    with pytest.raises(KeyboardInterrupt):
        estimate_poses(room / "images", tmp_path / "out", FEW)
    fewer = shutil.copytree(room / "images", tmp_path / "fewer")
    (fewer / "view_0003.png").unlink()
    told = Told()
    with pytest.raises(KeyboardInterrupt):
        estimate_poses(fewer, tmp_path / "out", FEW, told)
    assert told.lines == ["other photos or options than before: beginning again"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("cameras.xml", "<document>\n<chunk label=''>", "poses of Metashape are not read"),
        ("site/cameras.sfm", "", ""),
        ("poses_bounds.npy", "", "poses of LLFF are not read"),
        ("sparse/0/images.txt", "", "poses are there already (sparse/0): train"),
    ],
)
def test_nothing_is_estimated_without_a_word_on_poses_that_are_there(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: str, words: str
) -> None:
    root, told = tmp_path / "photos", Told()
    shutil.copytree(room / "images", root / "images")
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(content)
    monkeypatch.setattr(poses, "find_features", _interrupted)
    with pytest.raises(KeyboardInterrupt):
        estimate_poses(root, tmp_path / "out", FEW, told)
    lines = [line for line in told.lines if line.startswith(f"estimating poses anew: {words}")]
    assert len(lines) == bool(words)


def test_masks_of_photos_alone_are_resampled_as_the_photos_are(room: Path, tmp_path: Path) -> None:
    """Where a photo is bright, so is its mask, before the lens is taken out and after it."""
    photos, out, count = tmp_path / "photos", tmp_path / "scene", VIEWS // 3
    for name in ("images", "mask"):
        (photos / name).mkdir(parents=True)
    for path in sorted((room / "images").iterdir())[:count]:
        shutil.copy(path, photos / "images")
    for path in sorted((photos / "images").iterdir())[1:]:
        with Image.open(path) as photo:
            bright = photo.convert("L").point(lambda value: 255 * (value > 127))
            bright.save(photos / "mask" / f"{path.stem}.png")
    report = estimate_poses(photos, out, PoseOptions(features=1024))
    assert f"masks: {count - 1} of {count} photos, in mask/" in report.text()
    scene = load_scene(out)
    assert scene.views[0].mask is None and scene.views[1].mask is not None
    assert f"masks: {count - 1} of {count} photos, in masks/" in scene.account.text()
    for view in (1, count // 2):
        mask, image = scene.mask(view), Image.fromarray(scene.image(view)).convert("L")
        assert mask is not None
        assert ((np.asarray(image) > 127) == (mask > 0.5)).mean() > 0.97
    again = Told()
    estimate_poses(photos, out, PoseOptions(features=1024), again)
    assert not any("matching" in line for line in again.lines)


def test_alpha_channels_of_cut_outs_become_masks(room: Path, tmp_path: Path) -> None:
    photos, out = tmp_path / "photos", tmp_path / "scene"
    (photos / "images").mkdir(parents=True)
    count = VIEWS // 3
    for path in sorted((room / "images").iterdir())[:count]:
        with Image.open(path) as photo:
            cut = photo.convert("RGBA")
            # Nearly opaque everywhere, so that there is enough to match.
            alpha = Image.new("L", photo.size, 200)
            alpha.paste(255, (0, 0, photo.width // 2, photo.height))
            cut.putalpha(alpha)
            cut.save(photos / "images" / f"{path.stem}.png")
    report = estimate_poses(photos, out, PoseOptions(features=1024, alpha=True))
    assert f"masks: {count} of {count} photos, their alpha channels" in report.text()
    scene = load_scene(out)
    mask = scene.mask(1)
    assert mask is not None
    middle = mask.shape[1] // 2
    assert mask[:, : middle - 20].min() > 0.95 and mask[:, middle + 20 :].max() < 0.85
    with pytest.raises(SceneError, match="--masks alpha"):
        estimate_poses(room, tmp_path / "other", PoseOptions(alpha=True))


def test_the_account_of_an_estimation_goes_along_with_its_scene(
    room: Path, posed: tuple[Path, Told], tmp_path: Path
) -> None:
    out = shutil.copytree(posed[0], tmp_path / "out")
    values = json.loads((out / "scene.json").read_text())
    assert values["account"]["photos"] == VIEWS
    above = values["account"]["beside"]
    assert above == [f"the folder above has poses that are not read: give {room}"]
    assert above[0] in PoseReport(out, 1, _found(), "", {}, (), load_scene(out).account).text()
    values["account"] |= {"left_out": {"not placed": ["x.png"]}, "unread": {".heic": 2}}
    (out / "scene.json").write_text(json.dumps(values))
    text = load_scene(out).account.text()
    assert text.startswith(f"{VIEWS} of {VIEWS + 1} photos used, poses of sparse/0; 1 not placed")
    assert "not looked at: 2 .heic" in text


def _found() -> Reconstructed:
    return Reconstructed("global", (), (), 0, 0, 0, ())


def test_photos_that_do_not_overlap_are_refused_with_what_to_try(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "photos").mkdir()
    for number in range(4):
        pixels = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
        Image.fromarray(pixels).save(tmp_path / "photos" / f"{number}.png")
    assert cli.main(["scene", str(tmp_path / "photos"), str(tmp_path / "out"), "--quiet"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "found 0 of 4 photos that fit together, expected at least 3; neighbouring" in lines[0]
    assert not (tmp_path / "out" / "images").exists()


def test_a_scene_is_not_written_among_photos_or_into_another_folder(
    room: Path, tmp_path: Path
) -> None:
    with pytest.raises(SettingError, match="found the folder of the photos"):
        estimate_poses(room / "images", room, FEW)
    (tmp_path / "letters.txt").write_text("")
    with pytest.raises(SettingError, match="a folder with other files"):
        estimate_poses(room / "images", tmp_path, FEW)
    with pytest.raises(SceneError, match="no such folder"):
        estimate_poses(tmp_path / "nowhere", tmp_path / "out", FEW)


@pytest.mark.parametrize("missing", [["scene.png", "scene.json"], ["scene.json"]])
def test_a_scene_goes_on_that_was_killed_while_a_file_of_it_was_written(
    room: Path, posed: tuple[Path, Told], tmp_path: Path, missing: list[str]
) -> None:
    out, name = tmp_path / "out", missing[0]
    shutil.copytree(unreported(posed[0]), out)
    for path in {"scene.png", "scene.json"}.difference(missing):
        shutil.copy(posed[0] / path, out)
    left = out / f".{name}.{2**22 + 1}.abcd_123.draft"  # of a process that no system has
    left.mkdir()
    (left / name).touch()
    estimate_poses(room / "images", out, FEW)
    assert (out / name).is_file() and not left.exists()


def test_what_a_kill_left_after_the_report_goes(
    room: Path, posed: tuple[Path, Told], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(posed[0], out)
    for name in ("sfm", "frames"):
        (out / name).mkdir()
        (out / name / "left").touch()
    estimate_poses(room / "images", out, FEW)
    assert not (out / "sfm").exists() and not (out / "frames").exists()


def test_train_estimates_poses_of_photos_on_the_way_and_says_so(
    room: Path,
    posed: tuple[Path, Told],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def copied(photos: Path, out: Path, options: PoseOptions, observer: Observer) -> PoseReport:
        shutil.copytree(posed[0], out)
        return estimate_poses(photos, out, FEW, observer)

    monkeypatch.setattr(poses, "estimate_poses", copied)
    words = ["--steps", "2", "--set", "model.slots=4", "model.hidden=8", "--no-evaluate"]
    run = tmp_path / "run"
    line = ["train", str(room / "images"), "--out", str(run), "--scale", "4", *words]
    assert cli.main(line) == 0
    assert "holds photos without poses: estimating poses into" in capsys.readouterr().err
    assert len(check_file(run / "scene.gsyn").levels) == 4
    assert len(load_scene(run / "scene").views) == VIEWS


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(("kind", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_while_photos_are_matched_is_one_line(
    room: Path, tmp_path: Path, kind: signal.Signals, code: int
) -> None:
    """pycolmap has a handler of its own, which prints its stack."""
    photos = tmp_path / "photos"
    photos.mkdir()
    for path in sorted((room / "images").iterdir())[: VIEWS // 2]:
        shutil.copy(path, photos)
    line = [sys.executable, "-m", "gsynopsis", "scene", str(photos), str(tmp_path / "s")]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        assert any("matching: " in line for line in iter(child.stderr.readline, ""))
        child.send_signal(kind)
        rest = child.stderr.read()
        assert child.wait(timeout=120) == code
    assert rest.splitlines()[-1] == "gsynopsis: interrupted"
    assert "***" not in rest and "Traceback" not in rest
    assert {path.name for path in (tmp_path / "s").iterdir()} == {"sfm"}
