"""More steps for a run that was made with fewer."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gsynopsis.config import Config
from gsynopsis.errors import CheckpointError
from gsynopsis.training.checkpoint import read_checkpoint
from gsynopsis.training.extend import extend_run
from gsynopsis.training.loop import CHECKPOINT, FULL, open_state, run_training
from gsynopsis.training.observer import Silent, StepInfo
from tests.training.test_loop import (
    JOINT,
    SEQUENTIAL,
    TIED,
    StopAfter,
    context,
    opened,
    result,
    trained,
)


class Steps(Silent):
    def __init__(self) -> None:
        self.seen = list[tuple[str, int]]()

    def on_step(self, info: StepInfo) -> None:
        self.seen.append((info.phase, info.step))


def longer(config: Config, steps: int = 8, levels: int = 4) -> Config:
    train = replace(config.train, steps=config.train.steps + steps)
    return replace(
        config, train=train, levels=replace(config.levels, steps=config.levels.steps + levels)
    )


def go_on(config: Config, out: Path) -> str:
    return extend_run(out, context(config).scene.fingerprint(), config)


@pytest.mark.parametrize("config", [JOINT, SEQUENTIAL, TIED], ids=["joint", "sequential", "tied"])
def test_a_finished_run_keeps_its_full_steps_and_makes_its_levels_anew(
    config: Config, tmp_path: Path
) -> None:
    first = result(trained(config, tmp_path))
    more, before = longer(config), config.train.steps
    said = go_on(more, tmp_path)
    assert f"the full model's {before} are kept, 8 more follow" in said
    assert f"levels are made anew in {more.levels.steps} steps" in said
    steps, t = Steps(), opened(tmp_path, more)
    assert run_training(t, tmp_path, steps, lambda: False)
    assert steps.seen[0] == ("full", before + 1)
    assert ("full", before + 8) in steps.seen and ("full", before + 9) not in steps.seen
    assert result(t) != first
    assert go_on(more, tmp_path) == "", "it is a run of so many steps now"


def test_a_longer_run_that_is_stopped_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    more = longer(JOINT)
    found: list[str] = []
    for name, asks in (("whole", 10**6), ("parts", 5)):
        out = tmp_path / name
        out.mkdir()
        trained(JOINT, out)
        assert go_on(more, out)
        t = opened(out, more)
        while not run_training(t, out, Silent(), StopAfter(asks)):
            t = opened(out, more)
        found.append(result(t))
    assert found[0] == found[1]


def test_a_run_stopped_in_its_full_training_goes_on_there(tmp_path: Path) -> None:
    assert not run_training(opened(tmp_path, JOINT), tmp_path, Silent(), StopAfter(3))
    more = longer(JOINT)
    assert go_on(more, tmp_path).startswith(f"more steps: 3 of {JOINT.train.steps} are kept")
    steps = Steps()
    assert run_training(opened(tmp_path, more), tmp_path, steps, lambda: False)
    assert steps.seen[0] == ("full", 4)


def test_more_steps_of_the_levels_alone_keep_the_full_model(tmp_path: Path) -> None:
    trained(JOINT, tmp_path)
    more = longer(JOINT, 0, 5)
    assert "are kept, as they are; levels are made anew" in go_on(more, tmp_path)
    steps = Steps()
    assert run_training(opened(tmp_path, more), tmp_path, steps, lambda: False)
    assert steps.seen[0] == ("joint", 1)


@pytest.mark.parametrize("change", ["fewer", "seed", "scene"])
def test_what_is_more_than_more_steps_is_refused_as_before(change: str, tmp_path: Path) -> None:
    trained(JOINT, tmp_path)
    before = (tmp_path / CHECKPOINT).read_bytes()
    config = longer(JOINT, -2, -1) if change == "fewer" else longer(JOINT)
    if change == "seed":
        config = replace(config, train=replace(config.train, seed=9))
    given = context(config, points=121 if change == "scene" else 120)
    assert extend_run(tmp_path, given.scene.fingerprint(), config) == ""
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    with pytest.raises(CheckpointError):
        open_state(given, tmp_path, Silent())


def test_nothing_happens_without_a_checkpoint_nor_without_the_full_model(tmp_path: Path) -> None:
    assert go_on(longer(JOINT), tmp_path) == ""
    trained(JOINT, tmp_path)
    (tmp_path / FULL).unlink()
    assert go_on(longer(JOINT), tmp_path) == ""
    state, _ = read_checkpoint(tmp_path / CHECKPOINT)
    assert json.loads(state["config"])["train"]["steps"] == JOINT.train.steps
