"""Checkpoints that are refused, kept, or of an older version."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from gsynopsis.config import RATES
from gsynopsis.errors import CheckpointError, DivergedError, SpaceError
from gsynopsis.training import checkpoint
from gsynopsis.training.progress import Silent
from gsynopsis.training.run import CHECKPOINT, is_complete, run_training
from tests.training.test_run import JOINT, StopAfter, opened, result, trained


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


def former(state: dict, **levels: object) -> None:
    """The settings of a checkpoint as version 0.1 recorded them."""
    config = json.loads(state["config"])
    model, train, now = config["model"], config["train"], config["levels"]
    model["init_factor"] = train["growth"].pop("cell")
    model["opacity_spread"] = model.pop("opacity_init_scale")
    train["average"], train["subpixels"] = train.pop("weight_average"), train.pop("subpixel_jitter")
    train["rates"] = asdict(RATES[train["rates"]])
    del train["rates"]["unit_extent"]
    names = {"tied": "common", "separate": "own"}
    now |= {"networks": names[now["weights"]], "weights": now.pop("loss_weights")}
    now |= {"faint_share": now.pop("prune_share"), "together": now.pop("levels_per_step")}
    now |= {"always_finest": True, "grid_drop": 1, "gain": True, "spread": 0.125}
    now |= {"joint_rates": 1.0} | levels
    state["config"] = json.dumps(config | {"preset": "paper"})
    del state["growth"]


def test_a_run_of_an_older_version_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    expected = result(trained(JOINT, tmp_path / "whole"))
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(37))
    changed_state(tmp_path / CHECKPOINT, former)
    t = opened(tmp_path)
    assert t.cursor.step == 7 and not is_complete(t)
    assert run_training(t, tmp_path, Silent(), lambda: False)
    assert is_complete(t) and result(t) == expected


@pytest.mark.parametrize(("steps", "grows"), [(3, True), (37, False)])
def test_a_model_that_began_to_grow_by_the_former_rule_is_refused(
    tmp_path: Path, steps: int, grows: bool
) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(steps))
    changed_state(tmp_path / CHECKPOINT, lambda state: state.pop("growth"))
    if grows:
        with pytest.raises(CheckpointError, match="growth: found a model that grew by the rule"):
            opened(tmp_path)
    else:
        assert run_training(opened(tmp_path), tmp_path, Silent(), lambda: False)


def test_a_run_with_a_setting_that_is_gone_is_refused_in_one_line(tmp_path: Path) -> None:
    run_training(opened(tmp_path), tmp_path, Silent(), StopAfter(3))
    changed_state(tmp_path / CHECKPOINT, lambda state: former(state, joint_rates=0.5))
    with pytest.raises(CheckpointError, match=r"joint_rates: found 0.5, .* wrote the run$"):
        opened(tmp_path)
