"""What `train` says before it starts."""

import re
from dataclasses import replace

import pytest
import torch
from PIL import Image

from gsynopsis.config import Recipe, replaced
from gsynopsis.errors import SettingError, SpaceError
from gsynopsis.jobs.train_run import before_training
from gsynopsis.render.choose import make_renderer
from gsynopsis.resources.estimate import make_plan
from gsynopsis.resources.report import bounded, plan_lines, plan_of
from gsynopsis.scene.stored import AT_ONCE, Decoding
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup
from tests.tiny import tiny_config, tiny_scene

PLAN = replace(
    make_plan(tiny_scene(), tiny_config(), torch.device("cpu"), ProcessGroup()),
    start_bytes=2**30,
    most_bytes=4 * 2**30,
    free_bytes=8 * 2**30,
)


SETUP = TrainContext(tiny_scene(), tiny_config(), make_renderer("cpu"))


def test_a_memory_limit_becomes_a_limit_of_anchors() -> None:
    assert plan_of(bounded(SETUP, None)).max_anchors == 1_000_000
    limited = bounded(SETUP, 0.6)
    plan, most = plan_of(limited), limited.config.train.growth.max_anchors
    assert plan.anchors < plan.max_anchors == most < 1_000_000
    assert plan.start_bytes < plan.most_bytes < 0.6 * 2**30
    few = replace(SETUP, config=replaced(SETUP.config, {"train.growth.max_anchors": 130}))
    assert plan_of(bounded(few, 64)).max_anchors == 130, "the smaller limit holds"


def test_a_limit_that_stops_growth_is_said() -> None:
    recipe = Recipe("standard", SETUP.config)
    for limit, said in ((0.6, True), (64, False)):
        context = bounded(SETUP, limit)
        line = f"plan: --max-memory stops growth at {plan_of(context).max_anchors:,} anchors"
        assert (line in before_training(context, recipe)) == said


def test_a_memory_limit_leaves_an_eighth_of_it_for_photos_in_memory() -> None:
    context = replace(SETUP, scene=tiny_scene())
    bounded(context, 0.8)
    assert context.scene.cache.budget == round(0.1 * 2**30)
    bounded(context, 64)
    assert context.scene.cache.budget == round(0.1 * 2**30), "the smaller limit holds"


def test_a_limit_that_not_even_the_start_fits_is_refused_with_what_would_do() -> None:
    with pytest.raises(SpaceError, match=r"--max-memory: found 0.1 GiB, expected at least") as e:
        bounded(SETUP, 0.1)
    least = re.search(r"at least ([\d.]+) GiB", str(e.value))
    assert least is not None
    assert plan_of(bounded(SETUP, float(least[1]))).max_anchors >= PLAN.anchors
    assert str(e.value).endswith("allow more"), "no cell makes room for the process itself"


def test_the_cell_that_a_refusal_advises_starts_within_the_limit() -> None:
    context = replace(SETUP, scene=tiny_scene(points=20_000))
    with pytest.raises(SpaceError, match=r"allow more, or give --model\.voxel") as e:
        bounded(context, 0.4)
    cell = re.search(r"--model.voxel ([\d.]+):", str(e.value))
    assert cell is not None
    other = replace(context, config=replaced(context.config, {"model.voxel": float(cell[1])}))
    plan = plan_of(bounded(other, 0.4))
    assert plan.anchors <= plan.max_anchors and plan.most_bytes < 0.4 * 2**30


def test_a_memory_limit_counts_the_decoding_of_the_largest_photo() -> None:
    """A black photo of 61 megapixels is small as a file, and at the size of the training."""
    scene = tiny_scene()
    large = tuple(replace(v, camera=v.camera.scaled(1 / 400)) for v in scene.views)
    assert large[0].camera.width == 24 * 400
    context = replace(SETUP, scene=replace(scene, views=large))
    context = replace(context, config=replace(context.config, scale=400.0))
    with pytest.raises(SpaceError, match=r"found 1 GiB, expected at least") as e:
        bounded(context, 1.0)
    least = re.search(r"at least ([\d.]+) GiB", str(e.value))
    assert least is not None and 1 < float(least[1]) < 1.6
    bounded(context, float(least[1]))


def test_photos_take_turns_within_a_memory_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Decoding(1)
    monkeypatch.setattr("gsynopsis.resources.report.DECODING", gate)
    for limit, pixels in ((None, AT_ONCE), (0.75, 8 << 20), (64, AT_ONCE)):
        bounded(replace(SETUP, scene=tiny_scene()), limit)
        with gate.of(Image.new("1", (pixels // 2, 1))):
            together, alone = Image.new("1", (pixels // 2, 1)), Image.new("1", (pixels, 1))
            assert gate.fits(together) and not gate.fits(alone)


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf"), 1e300])
def test_a_limit_that_is_no_size_is_refused(limit: float) -> None:
    with pytest.raises(SettingError, match="--max-memory"):
        bounded(SETUP, limit)


def test_the_plan_warns_when_the_machine_is_too_small() -> None:
    assert len(plan_lines(PLAN)) == len(plan_lines(replace(PLAN, free_bytes=None))) == 2
    tight = plan_lines(replace(PLAN, free_bytes=2 * 2**30))[2]
    assert "2.0 GiB are free" in tight and "--max-memory 1.6 " in tight
    assert "less than the start needs" in plan_lines(replace(PLAN, free_bytes=2**29))[2]
    both = plan_lines(replace(PLAN, processes=2, free_bytes=5 * 2**30))
    assert "in each of 2 processes" in both[1] and "--max-memory 2 " in both[2]


def test_the_plan_says_what_becomes_of_the_steps() -> None:
    assert (
        "300 steps full + 500 joint = 800"
        in plan_lines(PLAN, "300 steps full + 500 joint = 800")[0]
    )
    assert f"{PLAN.steps:,} steps" in plan_lines(PLAN)[0]


def test_points_beyond_the_lattice_are_counted() -> None:
    (line,) = [text for text in plan_lines(replace(PLAN, beyond=1234)) if "origin" in text]
    assert line.startswith("note: 1,234 points lie too many cells from the origin")
    assert PLAN.beyond == 0
