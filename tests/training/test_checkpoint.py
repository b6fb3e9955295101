"""Checkpoints that are refused, kept, or of an older version."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gsynopsis.errors import CheckpointError, DivergedError, SpaceError
from gsynopsis.training import checkpoint
from gsynopsis.training.loop import CHECKPOINT, run_training
from gsynopsis.training.observer import Silent
from tests.training.test_loop import JOINT, StopAfter, opened


def test_a_checkpoint_of_another_scene_is_refused(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    with pytest.raises(CheckpointError, match=r"scene: found a run of another scene.*--out"):
        run_training(opened(tmp_path, points=90), tmp_path, Silent(), lambda: False)


def test_other_settings_are_refused_with_the_fields_that_differ(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    other = replace(JOINT, train=replace(JOINT.train, steps=31, seed=4))
    with pytest.raises(CheckpointError, match=r"train.seed, train.steps: found 0, 30, expected"):
        run_training(opened(tmp_path, other), tmp_path, Silent(), lambda: False)


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    path = tmp_path / CHECKPOINT
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="expected a checkpoint; delete it"):
        run_training(opened(tmp_path), tmp_path, Silent(), lambda: False)


def test_a_full_disk_keeps_the_previous_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    before = (tmp_path / CHECKPOINT).read_bytes()

    def full(*args: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_file", full)
    with pytest.raises(SpaceError, match="No space left"):
        run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == [CHECKPOINT]


def test_too_little_disk_is_said_before_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=10)
    monkeypatch.setattr(checkpoint.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(SpaceError, match="found 10 bytes free"):
        run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(1))
    assert not list(tmp_path.iterdir())


def test_a_model_that_is_not_finite_does_not_replace_the_last_good_checkpoint(
    tmp_path: Path,
) -> None:
    t = opened(tmp_path)
    run_training(t, tmp_path, Silent(), StopAfter(3))
    before = (tmp_path / CHECKPOINT).read_bytes()
    t.model.log_scales.data[3, 2] = float("inf")
    with pytest.raises(DivergedError, match=r"step 3: tensor log_scales has .* is kept"):
        checkpoint.save_checkpoint(t, tmp_path / CHECKPOINT)
    assert (tmp_path / CHECKPOINT).read_bytes() == before


def changed_state(path: Path, change) -> None:
    """A checkpoint as another version might have written it."""
    state, tensors = checkpoint.read_checkpoint(path)
    change(state)
    checkpoint.write_aside(tensors, {"state": json.dumps(state)}, path)


def test_a_checkpoint_of_another_format_is_refused(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    changed_state(tmp_path / CHECKPOINT, lambda state: state.update(format="other-2"))
    with pytest.raises(CheckpointError, match=r"format: found other-2, expected .*version that"):
        run_training(opened(tmp_path), tmp_path, Silent(), lambda: False)


def test_a_setting_that_only_the_other_version_knows_is_named(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))

    def add(state: dict) -> None:
        config = json.loads(state["config"])
        config["train"]["warmth"] = 3
        state["config"] = json.dumps(config)

    changed_state(tmp_path / CHECKPOINT, add)
    with pytest.raises(CheckpointError, match=r"train.warmth: found no such setting"):
        run_training(opened(tmp_path), tmp_path, Silent(), lambda: False)


def test_a_setting_that_the_other_version_did_not_know_was_at_its_default(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))

    def remove(state: dict) -> None:
        config = json.loads(state["config"])
        del config["train"]["batch"]
        state["config"] = json.dumps(config)

    changed_state(tmp_path / CHECKPOINT, remove)
    other = replace(JOINT, train=replace(JOINT.train, batch=2))
    with pytest.raises(CheckpointError, match=r"train.batch: found 1, expected 2"):
        run_training(opened(tmp_path, other), tmp_path, Silent(), lambda: False)
    assert run_training(opened(tmp_path), tmp_path, Silent(), lambda: False)


def test_a_run_with_a_setting_that_is_gone_is_refused_in_one_line(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))

    def rename(state: dict) -> None:
        config = json.loads(state["config"])
        config["train"]["average"] = config["train"].pop("weight_average")
        state["config"] = json.dumps(config)

    changed_state(tmp_path / CHECKPOINT, rename)
    with pytest.raises(CheckpointError, match=r"train.average: found no such setting.*wrote it or"):
        opened(tmp_path)
