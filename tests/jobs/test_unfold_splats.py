"""A finished splat becomes trained levels that are near its own renders from the first step on."""

import errno
import io
import json
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gsynopsis import cli
from gsynopsis.container.reader import read_gsyn
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.jobs import unfold_splats as job
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.train_run import make_context
from gsynopsis.model.splats import decoder_of
from gsynopsis.records import PlainGaussians
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import look_at
from gsynopsis.scene.load import load_scene
from gsynopsis.teacher import renders
from gsynopsis.teacher.settings import teacher_recipe
from gsynopsis.training.loop import CHECKPOINT
from gsynopsis.training.observer import Silent, StepInfo
from tests.cameras.splat_scenes import hollow_sphere

pytestmark = pytest.mark.usefixtures("few_tries")
TEACHING = job.Teaching(views=8, width=64, held_out=3)
SHORT = {"train.steps": 6, "levels.steps": 10}
WORDS = ("--views", "8", "--width", "64", "--train.steps", "6", "--levels.steps", "10")
RESULT = "scene.gsyn"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return written(tmp_path)


def written(folder: Path) -> Path:
    path = folder / "object.ply"
    path.write_bytes(ply_bytes(hollow_sphere().gaussians, up=(0.0, 0.0, 1.0)))
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nobody stopped, and that no test changes."""
    folder = tmp_path_factory.mktemp("done")
    trained(written(folder), folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def whole(done: Path) -> bytes:
    """Its file."""
    return (done / RESULT).read_bytes()


def trained(source: Path, out: Path, **asked: object) -> bytes:
    settings = SHORT | {name.replace("__", "."): value for name, value in asked.items()}
    job.unfold_splats(source, out, settings, Silent(), RunOptions(evaluate=False), TEACHING)
    return (out / RESULT).read_bytes()


def test_the_first_picture_is_close_and_the_file_has_levels(source: Path, done: Path) -> None:
    out = done
    levels = read_gsyn(out / RESULT)
    assert len(levels.levels) == 4
    # As the input says it, whichever way its renders look.
    assert levels.meta["up"] == "0 0 1"
    scene = load_scene(out / job.RENDERS)
    assert any("renders of the input object.ply" in note for note in scene.notes)
    assert len(scene.train) == TEACHING.views and len(scene.test) == TEACHING.held_out
    given = job.usable(job.read_splats(source), source)
    renderer, model = make_renderer("cpu"), job.splat_model(given)
    cameras = [scene.camera(view) for view in scene.train]
    copied = job.what_to_copy(given, model, cameras, renderer, Silent())
    recipe = teacher_recipe(len(copied.splats), len(scene.train), copied.voxel, SHORT)
    begun = job.begun_state(make_context(scene, recipe.config, RunOptions()), copied)
    painter = LevelRenderer(begun.model, renderer)
    first = [psnr(painter.paint(scene.camera(v), -1), scene.image(v)) for v in scene.test]
    empty = [psnr(np.zeros_like(scene.image(v)), scene.image(v)) for v in scene.test]
    assert np.mean(first) > np.mean(empty) + 8


def test_the_same_bytes_twice_and_after_a_stop(
    source: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert trained(source, tmp_path / "b") == whole

    class Stops(Silent):
        def on_step(self, info: StepInfo) -> None:
            if (info.phase, info.step) == ("joint", 3):
                signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        job.unfold_splats(
            source, tmp_path / "c", SHORT, Stops(), RunOptions(evaluate=False), TEACHING
        )
    assert not (tmp_path / "c" / RESULT).exists()
    monkeypatch.setattr(job, "write_renders", None)  # they are there
    assert trained(source, tmp_path / "c") == whole


def test_a_stop_while_rendering_keeps_what_is_rendered(
    source: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "b"
    saved, save = list[Path](), Image.Image.save

    def full_disk(self: Image.Image, path: Path, *rest: object, **more: object) -> None:
        if isinstance(path, io.BytesIO):  # the contact sheet
            return save(self, path, *rest, **more)  # type: ignore[arg-type]
        if len(saved) == 5:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        saved.append(Path(path))
        save(self, path, *rest, **more)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "save", full_disk)
        with pytest.raises(job.InputError, match="No space left"):
            trained(source, out)
    assert not (out / job.RENDERS / renders.TRANSFORMS).exists()
    images = [path for path in sorted((out / job.RENDERS).rglob("*.*")) if path.is_file()]
    images.remove(out / job.RENDERS / job.TEACHER)
    assert [path.suffix for path in images] == [".png"] * 5, "whole ones, and no drafts"
    times = [path.stat().st_mtime_ns for path in images]
    assert trained(source, out) == whole
    assert [path.stat().st_mtime_ns for path in images] == times


def test_another_input_does_not_go_into_the_same_folder(
    source: Path, done: Path, tmp_path: Path
) -> None:
    out = Path(shutil.copytree(done, tmp_path / "run"))
    before = (out / RESULT).read_bytes()
    other = replace(job.read_splats(source).levels[-1], logits=np.zeros(990, np.float32))
    source.write_bytes(ply_bytes(other, up=(0.0, 0.0, 1.0)))
    with pytest.raises(job.SettingError, match="another input"):
        trained(source, out)
    assert (out / RESULT).read_bytes() == before


def test_the_command_says_what_it_did_and_evaluates_on_renders(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert cli.main(["unfold", str(source), "--out", str(out), *WORDS, "--json"]) == 0
    printed = capsys.readouterr()
    report = json.loads(printed.out)
    assert any("renders of the input" in note for note in report["notes"])
    assert len(report["levels"]) == 4
    assert "splats are the slots of" in printed.err
    assert (out / CHECKPOINT).exists()
    other = tmp_path / "other"
    words = ["--levels", "sequential", "--steps", "2", "--no-evaluate", "--quiet"]
    assert cli.main(["unfold", str(out), "--out", str(other), *words]) == 0
    assert len(read_gsyn(other / RESULT).levels) == 4


def test_what_is_empty_stays_so(source: Path, tmp_path: Path) -> None:
    """Renders on white have to be as near as those on black."""
    out = tmp_path / "run"
    trained(source, out, train__steps=20)
    scene, levels = load_scene(out / job.RENDERS), read_gsyn(out / RESULT)
    renderer, own = make_renderer("cpu"), decoder_of(levels)
    truth = job.splat_model(job.read_splats(source))
    for color in (torch.zeros(3), torch.ones(3)):
        pictures = [
            [LevelRenderer(m, renderer, color).paint(scene.camera(v), -1) for v in scene.test]
            for m in (own, truth)
        ]
        assert np.mean([psnr(a, b) for a, b in zip(*pictures, strict=True)]) > 20


def test_alpha_is_what_black_and_white_tell(source: Path, done: Path) -> None:
    scene = load_scene(done / job.RENDERS)
    alpha, view = renders.RenderedAlpha(scene), scene.train[0]
    camera, model = scene.camera(view), job.splat_model(job.read_splats(source))
    renderer = make_renderer("cpu")
    colors = torch.zeros(3), torch.ones(3)
    black, white = (LevelRenderer(model, renderer, color).paint(camera, 0) for color in colors)
    found = 1 - (white.astype(float) - black).mean(axis=2) / 255
    assert np.abs(alpha(view, 1, (0.0, 0.0)).numpy() - found).max() < 2.1 / 255
    assert alpha(view, 2, (0.0, 0.0)).shape == (18, 32)


def rows_around(off: float = 0.0) -> str:
    """A cameras.json of sixteen cameras around the object, or so far from it."""
    rows: list[dict[str, object]] = []
    for turn in np.arange(16) * np.pi / 8:
        eye = np.array([4 * np.cos(turn), 4 * np.sin(turn), 1.0]) + off
        w2c = look_at(eye, np.full(3, off), np.array([0.0, 0.0, 1.0]))
        pose = {"position": eye.tolist(), "rotation": w2c[:3, :3].T.tolist()}
        rows.append({"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, **pose})
    return json.dumps(rows)


def test_given_cameras_are_trained_on_and_said_in_the_report(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, cameras = tmp_path / "run", tmp_path / "known.json"
    cameras.write_text(rows_around())
    words = ["--cameras", str(cameras), *WORDS, "--json"]
    assert cli.main(["unfold", str(source), "--out", str(out), *words]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    said = f"cameras: 16 of {cameras}; up is taken as 0 0 1, as the file says"
    assert any(said in note for note in notes)
    scene = load_scene(out / job.RENDERS)
    assert len(scene.views) == 16 and scene.camera(scene.train[0]).height == 48
    assert (out / "scene.cameras.png").read_bytes().startswith(b"\x89PNG")
    cameras.write_text(rows_around(0.1))
    assert cli.main(["unfold", str(source), "--out", str(out), *words]) == 2
    assert "other views" in capsys.readouterr().err


def test_cameras_of_another_scene_are_one_line_and_leave_nothing(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, cameras = tmp_path / "run", tmp_path / "known.json"
    cameras.write_text(rows_around(1e4))
    words = ["--cameras", str(cameras), *WORDS, "--quiet"]
    assert cli.main(["unfold", str(source), "--out", str(out), *words]) == 2
    error = capsys.readouterr().err
    assert "nothing in view of 16 cameras" in error and error.count("\n") == 1
    assert not out.exists()


def fog() -> PlainGaussians:
    scene = hollow_sphere().gaussians
    return replace(scene, logits=np.full_like(scene.logits, -7.0))


def mesh(_: Path) -> bytes:
    lines = ["ply", "format ascii 1.0", "element vertex 3", "property float x"]
    lines += ["property float y", "property float z", "element face 1"]
    lines += ["property list uchar int vertex_indices", "end_header"]
    return ("\n".join([*lines, "0 0 0", "1 0 0", "0 1 0", "3 0 1 2"]) + "\n").encode()


def few(_: Path) -> bytes:
    g = hollow_sphere().gaussians
    names = ("means", "log_scales", "quaternions", "logits", "sh")
    return ply_bytes(PlainGaussians(*(getattr(g, name)[:1] for name in names)))


def spoilt(_: Path) -> bytes:
    g = hollow_sphere().gaussians
    return ply_bytes(replace(g, means=np.full_like(g.means, np.nan)))


BAD: dict[str, tuple[Callable[[Path], bytes], str]] = {
    "no file of splats": (lambda _: b"hello there", "begins with"),
    "empty": (lambda _: b"", "empty"),
    "mesh": (mesh, "splat|propert"),
    "one splat": (few, "at least 16"),
    "nan": (spoilt, "finite"),
    "fog": (lambda _: ply_bytes(fog()), "no camera sees enough"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_input_is_one_line_and_leaves_nothing(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, said = BAD[kind]
    path, out = tmp_path / "input.ply", tmp_path / "run"
    path.write_bytes(make(tmp_path))
    assert cli.main(["unfold", str(path), "--out", str(out), *WORDS, "--quiet"]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and error.startswith("gsynopsis: ")
    assert re.search(said, error), error
    assert not out.exists()


def test_options_out_of_range_are_refused_before_anything_is_read(tmp_path: Path) -> None:
    out = tmp_path / "run"
    for words in (("--views", "1"), ("--width", "9"), ("--model.slots", "99")):
        assert cli.main(["unfold", str(tmp_path / "none.ply"), "--out", str(out), *words]) == 2
    assert not out.exists()


def photographed(done: Path, folder: Path) -> Path:
    """A scene whose photos are darker than what the splats show, and one of them masked."""
    shutil.copytree(done / job.RENDERS, folder)
    for path in sorted((folder / "images").iterdir()):
        Image.fromarray(np.array(Image.open(path)) // 2).save(path)
    (folder / "masks").mkdir()
    mask = np.zeros((36, 64), np.uint8)
    mask[:, :32] = 255
    Image.fromarray(mask).save(folder / "masks" / "train_00000.png")
    return folder


def test_photos_of_the_scene_teach_beside_renders_and_are_reported_from(
    source: Path, done: Path, tmp_path: Path
) -> None:
    photos = load_scene(photographed(done, tmp_path / "photos"))
    lines = list[str]()

    class Hears(Silent):
        def on_message(self, text: str) -> None:
            lines.append(text)

    teaching, options = replace(TEACHING, scene=photos.root), RunOptions(evaluate=False)
    job.unfold_splats(source, tmp_path / "run", SHORT, Hears(), options, teaching)
    # After a stop between renders and the first step it is the same training.
    shutil.copytree(tmp_path / "run" / job.RENDERS, tmp_path / "again" / job.RENDERS)
    job.unfold_splats(source, tmp_path / "again", SHORT, Silent(), options, teaching)
    files = [(tmp_path / name / RESULT).read_bytes() for name in ("run", "again")]
    assert files[0] == files[1]
    made = load_scene(tmp_path / "run" / job.RENDERS)
    assert len(made.train) == TEACHING.views + len(photos.train)
    assert any("renders of the input have" in line for line in lines)
    assert any("photos are trained on" in note for note in made.notes)
    by_name = {view.name: number for number, view in enumerate(made.views)}
    for theirs, part in ((photos.test, "test"), (photos.train, "photos")):
        for number, view in enumerate(theirs):
            own = by_name[f"images/{renders.name_of(part, number)}"]
            assert own in (made.test if part == "test" else made.train)
            np.testing.assert_allclose(made.camera(own).w2c, photos.camera(view).w2c, atol=1e-9)
            mask = photos.mask(view)
            inside = slice(None) if mask is None else mask > 0
            np.testing.assert_array_equal(made.image(own)[inside], photos.image(view)[inside])
            if part == "photos":
                alpha = renders.RenderedAlpha(made)(own, 1, (0.0, 0.0))
                assert alpha.min() == 1
    # Outside of its mask a photo is the input's own render, which is brighter.
    own, view = by_name[f"images/{renders.name_of('photos', 0)}"], photos.train[0]
    mask = photos.mask(view)
    assert mask is not None
    outside = mask == 0
    assert made.image(own)[outside].mean() > 1.5 * photos.image(view)[outside].mean()
    # Renders are from other places than the photos, which tell what they show.
    places = {tuple(photos.camera(view).position) for view in photos.train}
    own_places = [made.camera(v).position for v in made.train if "/train_" in made.views[v].name]
    assert len(own_places) == TEACHING.views
    assert not places & {tuple(place) for place in own_places}


def test_photos_of_something_else_are_refused_before_anything_is_written(
    source: Path, done: Path, tmp_path: Path
) -> None:
    folder = photographed(done, tmp_path / "photos")
    names = sorted((folder / "images").iterdir())
    kept = [path.read_bytes() for path in names]
    for path, pixels in zip(names, kept[1:] + kept[:1], strict=True):
        path.write_bytes(pixels)
    teaching = replace(TEACHING, scene=folder)
    options, out = RunOptions(evaluate=False), tmp_path / "run"
    with pytest.raises(job.InputError, match=r"photos: found renders with .* leave --scene out"):
        job.unfold_splats(source, out, SHORT, Silent(), options, teaching)
    assert not out.exists()


def test_what_is_for_splats_is_not_passed_over_with_a_run(
    done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for word in ("scene", "cameras"):
        asked = [str(done), "--out", str(tmp_path / "b"), f"--{word}", str(done / job.RENDERS)]
        assert cli.main(["unfold", *asked]) == 2
        assert f"--{word}" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
