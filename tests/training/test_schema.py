"""A checkpoint may be anyone's: whatever is wrong with it is one line, before anything is used."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from gsynopsis.config import Config
from gsynopsis.errors import CheckpointError
from gsynopsis.training import checkpoint
from gsynopsis.training.checkpoint import begin_from, recorded_phase
from gsynopsis.training.loop import CHECKPOINT, FULL, run_training
from gsynopsis.training.observer import Silent
from tests.training.test_loop import JOINT, SEQUENTIAL, StopAfter, context, opened

Tensors = dict[str, Tensor]
Change = Callable[[Tensors, dict[str, Any]], object]


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Trainings that were stopped in their first phase and in their second."""
    found: dict[str, Path] = {}
    for name, config in (("joint", JOINT), ("sequential", SEQUENTIAL)):
        for steps in (3, 35):
            out = tmp_path_factory.mktemp(f"{name}{steps}")
            run_training(opened(out, config), out, Silent(), StopAfter(steps))
            found[f"{name} {steps}"] = out
    return found


def spoilt(path: Path, change: Change) -> None:
    with safe_open(path, framework="pt") as file:
        tensors = {n: file.get_tensor(n).clone() for n in file.keys()}  # noqa: SIM118
        state = json.loads((file.metadata() or {})["state"])
    change(tensors, state)
    save_file(tensors, path, metadata={"state": json.dumps(state)})


def without(name: str) -> Change:
    return lambda tensors, state: tensors.pop(name)


def made(name: str, change: Callable[[Tensor], Tensor]) -> Change:
    return lambda tensors, state: tensors.update({name: change(tensors[name])})


def deeper(tensor: Tensor) -> Tensor:
    return tensor[None].clone()


def refused(source: Path, out: Path, change: Change, config: Config = JOINT) -> str:
    shutil.copytree(source, out, dirs_exist_ok=True)
    spoilt(out / CHECKPOINT, change)
    with pytest.raises(CheckpointError) as error:
        run_training(opened(out, config), out, Silent(), StopAfter(2))
    line = str(error.value)
    assert "\n" not in line and len(line) < 700 and str(out / CHECKPOINT) in line
    return line


@pytest.mark.parametrize("of", ["joint 3", "joint 35", "sequential 3", "sequential 35"])
def test_every_tensor_is_there_with_its_type_and_shape(
    stopped: dict[str, Path], tmp_path: Path, of: str
) -> None:
    config = JOINT if of.startswith("joint") else SEQUENTIAL
    with safe_open(stopped[of] / CHECKPOINT, framework="pt") as file:
        names = sorted(file.keys())
    needed = [n for n in names if not n.startswith("adam.")]
    for number, name in enumerate(needed[:: max(1, len(needed) // 12)]):
        changes = (without(name), made(name, Tensor.double), made(name, deeper))
        lines = [
            refused(stopped[of], tmp_path / f"{number} {kind}", change, config)
            for kind, change in enumerate(changes)
        ]
        assert all(": found " in line and "delete it to start again" in line for line in lines)
    moment = next(n for n in names if n.endswith(".exp_avg"))
    line = refused(
        stopped[of], tmp_path / "adam", lambda t, s: t.update({moment: t[moment][:-1]}), config
    )
    assert moment in line
    line = refused(stopped[of], tmp_path / "none", lambda t, s: t.pop(moment), config)
    assert "found nothing" in line


RECORDS: dict[str, tuple[Any, str]] = {
    "cursor": (5, "cursor: found int, expected object"),
    "cursor.step": (-1, "cursor.step: expected int >= 0"),
    "cursor.phase": (99, "cursor.phase: found 99, expected at most 2"),
    "cursor.order": ([999], "cursor.order: found view 999"),
    "cursor.seconds": (1e300, "cursor.seconds"),
    "cursor.loss": ("NaN", "cursor.loss: found str, expected float"),
    "cursor.trained_bytes": ([[1]], "cursor.trained_bytes: found 1 rows"),
    "grids": ([], "grids"),
    "grids ": ([12, 0, 3], "grids"),
    "numpy": ({}, "random: found"),
    "numpy.state": ({"state": -1, "inc": 2**200}, "random: found"),
    "scene": (None, "scene: found null, expected str"),
    "config": ("[" * 3000, "found settings"),
    "config ": ("3", "found settings"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_is_of_its_schema(stopped: dict[str, Path], tmp_path: Path, name: str) -> None:
    value, said = RECORDS[name]
    *groups, last = name.strip().split(".")

    def change(tensors: Tensors, state: dict[str, Any]) -> None:
        inner = state
        for group in groups:
            inner = inner[group]
        inner[last] = value

    assert said.removeprefix("found ") in refused(stopped["joint 3"], tmp_path, change)


def test_numbers_that_cannot_be_are_refused(stopped: dict[str, Path], tmp_path: Path) -> None:
    def put(name: str, value: float) -> Change:
        return lambda t, s: t[name].view(-1)[0].fill_(value)

    cases = {
        "model.log_scales": (float("nan"), "not finite"),
        "part.0.log_gain": (float("inf"), "not finite"),
        "model.lattice": (2**40, "cells far outside"),
    }
    for number, (name, (value, said)) in enumerate(cases.items()):
        line = refused(stopped["joint 3"], tmp_path / str(number), put(name, value))
        assert f"{name}: found " in line and said in line


@pytest.mark.parametrize("kind", ["link", "pipe", "folder", "nothing in it", "other bytes"])
def test_only_a_regular_file_is_a_checkpoint(
    stopped: dict[str, Path], tmp_path: Path, kind: str
) -> None:
    path = tmp_path / CHECKPOINT
    if kind == "link":
        path.symlink_to(stopped["joint 3"] / CHECKPOINT)
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.write_bytes(b"" if kind == "nothing in it" else b"\xff" * 1000)
    with pytest.raises(CheckpointError, match="expected a checkpoint; delete it to start again"):
        opened(tmp_path)
    assert recorded_phase(path) == -1


def test_a_link_to_the_full_model_is_not_copied(stopped: dict[str, Path], tmp_path: Path) -> None:
    full = stopped["joint 35"] / FULL
    assert full.is_file()
    (tmp_path / FULL).symlink_to(full)
    other, out = context(SEQUENTIAL), tmp_path / "out"
    out.mkdir()
    with pytest.raises(CheckpointError, match="found a link"):
        begin_from(other, tmp_path / FULL, out / FULL, out / CHECKPOINT)
    with pytest.raises(CheckpointError, match="another scene"):
        begin_from(context(JOINT, points=90), full, out / FULL, out / CHECKPOINT)
    assert not list(out.iterdir())
    begin_from(context(JOINT), full, out / FULL, out / CHECKPOINT)
    assert (out / FULL).read_bytes() == full.read_bytes()


def test_a_checkpoint_replaces_a_link(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    for name in (CHECKPOINT, FULL, "checkpoint.tmp"):
        (run / name).symlink_to(secret)
    checkpoint.write_aside({"a": torch.zeros(2)}, {"state": "{}"}, run / CHECKPOINT)
    assert secret.read_text() == "mine" and not (run / CHECKPOINT).is_symlink()
