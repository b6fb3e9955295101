"""Each rival from a scene to nested levels, a file and a report."""

import json
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from gsynopsis.container import check_file, decode
from gsynopsis.errors import InputError, SettingError
from gsynopsis.evaluation.report import Report
from gsynopsis.model.splats import plain_level
from gsynopsis.records import PlainGaussians
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from research.baselines import methods
from research.baselines.checkpoint_cache import TrainingCache
from research.baselines.gaussians import from_points
from research.baselines.methods import METHODS, Task, contributions, counts_of, gradients, taken
from research.baselines.train import FILE, run_baseline
from research.suites.experiment import UNCODED_FILE
from research.suites.suite import BaselineName

RENDERER = make_renderer("cpu")
SPLATS = sorted(METHODS.keys() - {"octree"})
"""Octree-GS has a file of tests of its own."""
NESTED = sorted(set(SPLATS) - {"gaussians"})


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("rivals") / "room"
    return load_scene(make_scene("room", folder, views=10, width=48, height=32, points=300))


def task(scene: Scene, steps: int = 60, level_steps: int = 40) -> Task:
    return Task(scene, RENDERER, 1.0, steps, level_steps, rates=4.0, reset=False)


def test_suites_know_all_of_them() -> None:
    assert set(get_args(BaselineName)) == set(METHODS)


@pytest.fixture(scope="module")
def trained(
    scene: Scene, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], tuple[Report, Path]]:
    """Trains a rival once; gives its report and folder."""

    @cache
    def train(name: str) -> tuple[Report, Path]:
        folder = tmp_path_factory.mktemp(name)
        return run_baseline(name, task(scene, 100, 100), folder), folder

    return train


@pytest.mark.parametrize("name", SPLATS)
def test_it_leaves_a_file_and_figures_of_its_levels(
    name: str, trained: Callable[[str], tuple[Report, Path]]
) -> None:
    report, folder = trained(name)
    count = 1 if name == "gaussians" else 4
    assert len(report.levels) == len(check_file(folder / FILE).levels) == count
    told = json.loads((folder / "metrics.json").read_text())
    assert [level["psnr_full"] for level in told["levels"]] == [
        level.quality.psnr_full for level in report.levels
    ]
    anchors = [level.anchors for level in report.levels]
    assert anchors == sorted(set(anchors)) and report.provenance.preset == name
    for level in report.levels:
        # Position, scales, rotation, opacity and colours as float32.
        again = sum(anchors[: level.level]) if name == "lapis" else 0  # opacities, sent anew
        assert level.sizes.bytes_paper == 4 * (59 * level.anchors + again)
        assert level.sizes.bytes_compact < level.sizes.bytes_deflate < level.sizes.bytes_paper
    assert report.levels[-1].quality.psnr_full > 15
    uncoded = json.loads((folder / UNCODED_FILE).read_text())
    for level, psnr in zip(report.levels, uncoded, strict=True):
        assert psnr > level.quality.psnr_full - 0.3


@pytest.mark.parametrize("name", NESTED)
def test_finer_levels_are_nearer_to_the_photos(
    name: str, trained: Callable[[str], tuple[Report, Path]]
) -> None:
    report, _ = trained(name)
    if name == "lapis":  # four fifths of its loss are SSIM
        ssim = [level.quality.ssim_full for level in report.levels]
        assert ssim[-1] > ssim[0] and ssim[2] > ssim[0] - 0.01
        return
    psnr = [level.quality.psnr_full for level in report.levels]
    assert psnr[-1] > psnr[0] and psnr[2] > psnr[0] - 0.2


def test_random_levels_make_coarse_ones_better_than_the_mere_order(
    trained: Callable[[str], tuple[Report, Path]],
) -> None:
    """What GoDe and Matryoshka are about, at equal pictures drawn."""
    names = ("contribution", "gode", "prefix", "layers")
    found = {name: trained(name)[0].levels[0].quality.psnr_full for name in names}
    for name in ("gode", "prefix", "layers"):
        assert found[name] > found["contribution"] + 0.5, found


def test_what_is_hidden_or_outside_contributes_nothing(scene: Scene) -> None:
    start = from_points(scene)
    means = start.means.copy()
    means[0] = 1e4
    start = type(start)(means, *list(vars(start).values())[1:])
    worth = contributions(start, task(scene))
    assert worth[0] == 0 and (worth >= 0).all() and worth.max() > 1


def test_scores_of_later_rounds_stand_above_those_of_earlier_ones(scene: Scene) -> None:
    start = from_points(scene)
    counts = counts_of(len(start))
    worth = gradients(start, counts, task(scene))
    order = np.argsort(-worth)
    for round_, count in enumerate(counts[-2::-1]):
        assert (worth[order[count:]] <= round_ + 1).all()
        assert (worth[order[:count]] >= round_ + 1).all()


def test_layers_of_lapis_gs_stay_as_the_coarser_level_left_them_but_for_opacities(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen = list[tuple[int, float]]()
    train = methods.train_gaussians

    def watched(start, scene, renderer, training, tick):
        seen.append((training.frozen, training.scale))
        assert training.ssim_weight == 0.8
        found = train(start, scene, renderer, training, tick)
        first = np.arange(training.frozen)
        for name, before in vars(start).items():
            same = np.array_equal(before[first], vars(found)[name][first])
            assert same == (name != "logits" or not len(first)), name
        return found

    monkeypatch.setattr(methods, "train_gaussians", watched)
    run_baseline("lapis", task(scene), tmp_path)
    assert [scale for _, scale in seen] == [8, 4, 2, 1]
    levels = decode((tmp_path / FILE).read_bytes(), "scene")
    counts = [level.anchors for level in levels.levels]
    assert [frozen for frozen, _ in seen] == [0, *counts[:-1]]


def test_rows_are_taken_of_all_values(scene: Scene) -> None:
    start = from_points(scene)
    found = taken(start, np.array([3, 1]))
    assert np.array_equal(found.means, start.means[[3, 1]]) and len(found.sh) == 2


def test_the_file_holds_what_was_trained(scene: Scene, tmp_path: Path) -> None:
    run_baseline("contribution", task(scene), tmp_path)
    levels = decode((tmp_path / FILE).read_bytes(), "scene")
    assert plain_level(levels, -1).degree == 3 and len(plain_level(levels, 0)) < len(
        plain_level(levels, 1)
    )


def test_what_one_has_grown_the_next_reads_and_counts(scene: Scene, tmp_path: Path) -> None:
    alone, first, second = (tmp_path / name for name in ("alone", "first", "second"))
    for folder in (alone, first, second):
        folder.mkdir()
    run_baseline("contribution", task(scene), alone)
    run_baseline("gaussians", replace(task(scene), kept=TrainingCache(tmp_path / "grown")), first)
    assert sorted(path.name for path in (tmp_path / "grown").iterdir()) == ["100.lock", "100.npz"]
    kept = TrainingCache(tmp_path / "grown")
    report = run_baseline("contribution", replace(task(scene), kept=kept), second)
    assert (second / FILE).read_bytes() == (alone / FILE).read_bytes()
    assert 0 < kept.seconds < report.provenance.train_seconds and kept.cpu_seconds > 0


@pytest.mark.parametrize("content", [b"PK, but no more of it", b"PK\3\4 cut off", b""])
def test_a_damaged_file_of_what_was_grown_is_one_line(
    content: bytes, scene: Scene, tmp_path: Path
) -> None:
    (tmp_path / "100.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"100\.npz: found .*expected trained Gaussians"):
        run_baseline("gaussians", replace(task(scene), kept=TrainingCache(tmp_path)), tmp_path)
    assert not (tmp_path / FILE).exists()


def test_who_needs_what_another_task_is_growing_waits_for_it(scene: Scene, tmp_path: Path) -> None:
    trained, found = list[int](), from_points(scene)

    def train() -> PlainGaussians:
        trained.append(1)
        time.sleep(0.3)
        return found

    with ThreadPoolExecutor(4) as pool:
        each = list(pool.map(lambda _: TrainingCache(tmp_path).grown("9", train), range(4)))
    assert trained == [1]
    assert all(np.array_equal(one.means, found.means) for one in each)


def test_an_unknown_one_is_one_line(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="found quadtree, expected gaussians or contribution"):
        run_baseline("quadtree", task(scene), tmp_path)
    assert not list(tmp_path.iterdir())
