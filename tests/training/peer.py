"""One of several processes of `test_world.py`: trains tiny cases and writes what came out.

python -m tests.training.peer FOLDER, with RANK, WORLD_SIZE and the meeting point as torchrun sets
them
"""

import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from gsynopsis.config import Config
from gsynopsis.errors import GsynopsisError
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.render.choose import make_renderer
from gsynopsis.training import checkpoint
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup, init_process_group
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from tests.tiny import half_size, tiny_config, tiny_scene


def of_two(config: Config) -> Config:
    """Two views a step, and a cell so small that slots soon leave those of their anchors."""
    model = replace(config.model, voxel=0.02)
    return replace(config, model=model, train=replace(config.train, batch=2))


CASES = {
    "joint": of_two(tiny_config(coding_loss=0.05)),
    "jittered": of_two(half_size(tiny_config())),
    "sequential": of_two(tiny_config(mode="sequential", steps=12)),
}
TASKS = Path("/proc/self/task")
"""Threads of this process and their names, on Linux."""
STOP = 17
"""Steps after which some runs stop: growth has begun and has counted views since."""


def context(case: str, group: ProcessGroup) -> TrainContext:
    return TrainContext(tiny_scene(), CASES[case], make_renderer("cpu"), FilePacker(), group)


def train(case: str, out: Path, group: ProcessGroup, steps: int = 10_000) -> bool:
    out.mkdir(parents=True, exist_ok=True)
    left = steps

    def stop() -> bool:
        nonlocal left
        left -= 1
        return left <= 0

    state = open_state(context(case, group), out, Silent())
    return run_training(state, out, Silent(), stop)


def poison(out: Path, group: ProcessGroup) -> str:
    """A value that is not finite in the last process only."""
    state = open_state(context("joint", group), out, Silent())

    class Poison(Silent):
        def on_step(self, info) -> None:
            if info.step == 3 and group.rank == group.size - 1:
                state.model.table.data[:] = float("nan")

    return failure(lambda: run_training(state, out, Poison(), lambda: False))


def fill_the_disk(out: Path, group: ProcessGroup) -> str:
    def full(*args: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    kept, checkpoint.save_file = checkpoint.save_file, full
    try:
        return failure(lambda: train("joint", out, group, 3))
    finally:
        checkpoint.save_file = kept


def failure(action: Callable[[], object]) -> str:
    """What it raised, as text."""
    try:
        action()
    except GsynopsisError as error:
        return f"{type(error).__name__}: {error}"
    return "none"


def main(folder: Path) -> None:
    torch.set_num_threads(1)
    with init_process_group() as group:
        own = folder / f"seen by {group.rank}"
        train("joint", own, group, 2)  # the first process writes its checkpoint, alone
        seen = {"apart": failure(lambda: train("joint", own, group, 2))}
        for case in CASES:
            train(case, folder / case / "two", group)
        train("joint", folder / "stopped by two", group, STOP)
        train("joint", folder / "stopped by one", group)
        (folder / "failing").mkdir(exist_ok=True)
        seen["poison"] = poison(folder / "failing", group)
        seen["full disk"] = fill_the_disk(folder / "disk", group)
        if group.rank == 1:
            (folder / "1.json").write_text(json.dumps(seen))
            os._exit(7)  # as if killed: no goodbye
        seen["gone"] = failure(lambda: train("joint", folder / "gone", group, 3))
    seen["threads"] = " ".join(path.read_text() for path in TASKS.glob("*/comm"))
    (folder / "0.json").write_text(json.dumps(seen))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
