"""A running training, looked at now and then: nothing of it is in the result."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import gsynopsis as gs
from gsynopsis.config import resolve_settings
from gsynopsis.errors import DivergedError, MissingExtraError
from gsynopsis.jobs.resolve import resolve
from gsynopsis.monitor import tensorboard as board
from gsynopsis.monitor.history import Snapshot, TrainingHistory
from gsynopsis.monitor.notebook import NotebookBar
from gsynopsis.monitor.snapshots import SECONDS, SHARE, SnapshotObserver
from gsynopsis.training.observer import Silent, StepInfo

STEP = StepInfo("full", 1, 10_000, 0.1, 20.0, 5, 0)
SMALL = {"train.steps": 6, "model.slots": 3, "model.hidden": 8}
GREY = np.full((4, 6, 3), 128, np.uint8)


@pytest.mark.parametrize("cost", [0.0, 0.01, 4.0])
def test_looking_takes_no_more_than_its_share_of_the_time(cost: float) -> None:
    now, seen = 0.0, list[tuple[float, Snapshot]]()

    def look() -> tuple[float, np.ndarray, np.ndarray]:
        nonlocal now
        now += cost
        return 20.0, GREY, GREY

    class Listener:
        def on_snapshot(self, snapshot: Snapshot) -> None:
            seen.append((now, snapshot))

    history = TrainingHistory([("full", STEP.steps)])
    watching = SnapshotObserver(look, [Listener()], history, lambda: now)
    for step in range(1, STEP.steps + 1):
        now += 0.05
        watching.on_step(replace(STEP, step=step))
    times = [moment for moment, _ in seen]
    assert len(times) > 5 and times[0] >= SECONDS
    assert all(b - a >= SECONDS for a, b in pairwise(times[:-1]))
    assert cost * len(times) <= SHARE * now + 2 * cost
    last = seen[-1][1]
    assert last.step == STEP.steps, "the end of a phase is looked at in any case"
    assert last.psnr == 20.0 and last.curve[-1][0] <= last.step


def test_a_look_that_fails_ends_nothing() -> None:
    def look() -> tuple[float, np.ndarray, np.ndarray]:
        raise DivergedError("not finite")

    class Listener:
        def on_snapshot(self, snapshot: Snapshot) -> None:
            pytest.fail("seen")

    watching = SnapshotObserver(look, [Listener()], TrainingHistory(()))
    watching.on_step(replace(STEP, step=STEP.steps))


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scenes") / "room"
    return gs.make_scene("room", out, views=9, width=32, height=24, points=150)


def test_a_training_that_is_looked_at_writes_the_same_file(room: Path, tmp_path: Path) -> None:
    scene, shown = gs.load_scene(room), list[str]()
    bar = NotebookBar(lambda html, text: shown.append(html))
    recipe, options = resolve("standard", scene, SMALL), {"evaluate": False}
    watched = gs.train(scene, recipe, tmp_path / "watched", bar, **options)
    plain = gs.train(scene, recipe, tmp_path / "plain", Silent(), **options)
    assert watched.file.read_bytes() == plain.file.read_bytes()
    assert "dB on held-out photos" in shown[-1] and shown[-1].count("<img src=") == 2


def test_tensorboard_has_loss_quality_and_pictures(room: Path, tmp_path: Path) -> None:
    reason = "tensorboard is not installed: extra 'tensorboard'; NOT tested"
    pytest.importorskip("tensorboard", reason=reason)
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    scene = gs.load_scene(room)
    options = {"evaluate": False, "tensorboard": True}
    recipe = resolve("standard", scene, SMALL)
    run = gs.train(scene, recipe, tmp_path / "run", Silent(), **options)
    events = EventAccumulator(str(run.folder / "tensorboard")).Reload()
    steps = [event.step for event in events.Scalars("held-out PSNR, dB")]
    total = resolve_settings("standard", 8, SMALL).config
    assert steps == [total.train.steps, total.train.steps + total.levels.steps]
    assert len(events.Scalars("loss")) == 2 and len(events.Images("rendering")) == 2


def test_without_tensorboard_it_is_one_line_before_anything_is_written(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(board.importlib, "import_module", absent)
    with pytest.raises(MissingExtraError, match=r"tensorboard.*gsynopsis\[tensorboard\]"):
        gs.train(room, "standard", tmp_path / "run", Silent(), tensorboard=True)
    assert not (tmp_path / "run").exists()
