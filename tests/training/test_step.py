"""A step of training in few files, and its views in order."""

import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import gsynopsis
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.state import TrainState, fresh_state, set_optimizer
from gsynopsis.training.step import next_views
from tests.tiny import tiny_config, tiny_scene

SOURCE = Path(gsynopsis.__file__).parent
FILES, LINES = 10, 2500
"""Most Python files that run in a step of the full model, and their lines."""


def full_training(steps: int) -> tuple[FullPhase, TrainState]:
    config = tiny_config()
    growth = replace(config.train.growth, until=1.0, every=steps)
    train = replace(config.train, steps=steps, growth=growth)
    context = TrainContext(tiny_scene(), replace(config, train=train), make_renderer("cpu"))
    phase, state = FullPhase(steps, steps), fresh_state(context)
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    return phase, state


def files_of_step(phase: FullPhase, state: TrainState) -> dict[str, set[int]]:
    """Numbers of the lines that one step runs, by file."""
    found: defaultdict[str, set[int]] = defaultdict(set)

    def trace(frame: FrameType, event: str, _: object) -> Any:
        path = frame.f_code.co_filename
        if not path.startswith(str(SOURCE)):
            return None
        found[path].add(frame.f_lineno)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        phase.step(state)
    finally:
        sys.settrace(before)
    state.progress.step += 1
    return found


def test_a_step_runs_in_few_files_that_are_short() -> None:
    phase, state = full_training(200)
    views = len(state.context.scene.train)
    for _ in range(2 * views):  # photos are held, and growth counts its views
        phase.step(state)
        state.progress.step += 1
    assert state.statistics[0].visits.sum() > 0
    found = files_of_step(phase, state)
    names = {str(Path(path).relative_to(SOURCE)) for path in found}
    needed = {"training/view_step.py", "model/native_view.py", "render/cpu.py", "scene/scene.py"}
    assert needed <= names
    assert len(names) <= FILES, sorted(names)
    assert sum(len(Path(path).read_text().splitlines()) for path in found) <= LINES


def test_every_view_comes_once_before_any_comes_again() -> None:
    state = full_training(10)[1]
    train = state.context.scene.train
    for _ in range(2):
        assert sorted(next_views(state)[0] for _ in train) == sorted(train)
