"""Whole runs in small: determinism, resume, nested levels, frozen shared tensors."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from gsynopsis.pipeline.packing import FilePacker
from gsynopsis.config import Config
from gsynopsis.errors import CheckpointError, DivergedError, SpaceError
from gsynopsis.model.build import model_to_levels
from gsynopsis.pack import encode
from gsynopsis.render.choose import make_renderer
from gsynopsis.train import checkpoint, run
from gsynopsis.train.progress import Silent
from gsynopsis.train.run import CHECKPOINT, FULL, run_training
from gsynopsis.train.trainer import Trainer
from tests.tiny import half_size, tiny_config, tiny_scene


def averaged(config: Config, share: float) -> Config:
    return replace(config, train=replace(config.train, average=share))


SEQUENTIAL = tiny_config(mode="sequential", steps=12)
JOINT = averaged(tiny_config(faint_share=0.03, coding_loss=0.05), 0.5)
COMMON = averaged(
    tiny_config(faint_share=0.03, coding_loss=0.05, networks="common", grid_drop=0, finish=3), 0.5
)
SHIFTED = half_size(JOINT)


def trainer(config: Config = JOINT, points: int = 120) -> Trainer:
    return Trainer(tiny_scene(points=points), config, make_renderer("cpu"), FilePacker())


def result(t: Trainer) -> str:
    assert t.model is not None
    return hashlib.sha256(encode(model_to_levels(t.model, {}), "raw")).hexdigest()


class StopAfter:
    def __init__(self, asks: int) -> None:
        self.left = asks

    def __call__(self) -> bool:
        self.left -= 1
        return self.left <= 0


def trained(config: Config, out: Path) -> Trainer:
    t = trainer(config)
    assert run_training(t, out, Silent(), lambda: False)
    return t


@pytest.mark.parametrize("config", [JOINT, SEQUENTIAL], ids=["joint", "sequential"])
def test_same_seed_same_bytes(config: Config, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    assert result(trained(config, tmp_path / "a")) == result(trained(config, tmp_path / "b"))


def test_another_seed_gives_another_result(tmp_path: Path) -> None:
    other = replace(JOINT, train=replace(JOINT.train, seed=1))
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    assert result(trained(JOINT, tmp_path / "a")) != result(trained(other, tmp_path / "b"))


@pytest.mark.parametrize(
    "config",
    [JOINT, SEQUENTIAL, COMMON, SHIFTED],
    ids=["joint", "sequential", "common", "shifted"],
)
def test_a_run_stopped_again_and_again_ends_like_an_uninterrupted_one(
    config: Config, tmp_path: Path
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()
    expected = result(trained(config, whole))
    for stops in (7, 1, 16, 9, 13, 1000):
        t = trainer(config)
        if run_training(t, parts, Silent(), StopAfter(stops)):
            break
    assert result(t) == expected


def test_levels_have_the_same_matrices_in_model_checkpoint_and_file(tmp_path: Path) -> None:
    t = trained(COMMON, tmp_path)
    assert t.model is not None and t.optimiser is not None
    first, *others = [t.model.part(k) for k in range(len(t.model.parts))]
    matrices = {name for name, weight in first.networks.items() if weight.ndim == 2}
    for part in others:
        for name, weight in first.networks.items():
            assert (part.networks[name] is weight) == (name in matrices)
    assert len({tuple(part.log_gain.tolist()) for part in (first, *others)}) == 4
    moved = {id(parameter) for parameter in t.optimiser.parameters()}
    assert all(id(w) in moved for part in (first, *others) for w in part.networks.values())
    assert len(moved) == len(t.optimiser.parameters())
    with safe_open(tmp_path / "checkpoint.safetensors", framework="pt") as handle:
        names = [name for name in handle.keys() if "networks." in name]  # noqa: SIM118
    held = [name.split(".") for name in names if name.startswith("part.")]
    assert {number for _, number, _, name in held if name in matrices} == {"3"}
    assert {number for _, number, _, name in held if name not in matrices} == set("0123")
    levels = model_to_levels(t.model, {})
    assert [levels.inherits(k) for k in range(4)] == [False, True, True, True]
    (tmp_path / "own").mkdir()
    own = trained(replace(COMMON, levels=replace(COMMON.levels, networks="own")), tmp_path / "own")
    apart = model_to_levels(own.model, {})
    assert not any(apart.inherits(k) for k in range(4))


def test_levels_of_a_run_are_nested_and_grow(tmp_path: Path) -> None:
    t = trained(SEQUENTIAL, tmp_path)
    levels = model_to_levels(t.model, {}).levels
    counts = [level.anchors for level in levels]
    assert len(levels) == 4 and counts == sorted(counts) and counts[0] < counts[-1]
    assert [level.grids for level in levels] == [1, 2, 3, 4]


def test_joint_levels_lose_faint_slots_six_times_and_keep_their_shares(tmp_path: Path) -> None:
    t, live, anchors = trainer(tiny_config(faint_share=0.03)), [], []

    class Watch(Silent):
        def on_step(self, info) -> None:
            if info.phase == "joint":
                assert t.model is not None
                masks = [t.model.part(k).mask for k in range(len(t.model.parts))]
                live.append(int(masks[-1].sum()))
                anchors.append([int(mask.any(dim=1).sum()) for mask in masks])

    assert run_training(t, tmp_path, Watch(), lambda: False)
    different = live[0:11:2]
    assert live[:-1] == [n for n in different[:5] for _ in range(2)] + [different[5]] * 9
    assert t.model is not None and len(t.model) * t.model.slots > different[0]
    assert different == sorted(set(different), reverse=True)
    for counts in anchors[0:11:2]:
        assert counts == [pytest.approx(counts[-1] * f, abs=1) for f in (0.14, 0.35, 0.7, 1.0)]


def test_a_phase_ends_with_the_mean_of_its_last_part(tmp_path: Path) -> None:
    """The oracle: the plain mean of what every step left."""
    t, seen = trainer(averaged(tiny_config(), 0.3)), list[dict[str, torch.Tensor]]()

    class Watch(Silent):
        def on_step(self, info) -> None:
            if info.phase == "joint" and info.step > 14:
                assert t.model is not None
                named = t.model.named_parameters()
                seen.append({name: value.detach().clone() for name, value in named})

    assert run_training(t, tmp_path, Watch(), lambda: False)
    assert t.model is not None and len(seen) == 6
    moved = set[str]()
    for name, value in t.model.named_parameters():
        if name == "logits":
            continue  # the codebook's choice is made from them, and they are dropped
        each = torch.stack([step[name] for step in seen])
        assert torch.allclose(value, each.mean(dim=0), rtol=1e-5, atol=1e-7), name
        moved |= {name} if not torch.equal(value, each[-1]) else set()
    assert {"offsets", "log_scales", "table", "parts.0.networks.color_w1"} <= moved


def test_no_means_are_taken_where_levels_split_off_later(tmp_path: Path) -> None:
    t = trainer(averaged(tiny_config(), 1.0))
    run_training(t, tmp_path, Silent(), StopAfter(29))
    assert t.optimiser is not None and t.cursor.phase == 0
    assert not any("average" in name for name in t.optimiser.tensors())


def test_sequential_levels_keep_the_asked_share_of_anchors(tmp_path: Path) -> None:
    levels = model_to_levels(trained(SEQUENTIAL, tmp_path).model, {}).levels
    for keep, fine, coarse in zip(
        SEQUENTIAL.levels.keep, reversed(levels[1:]), reversed(levels[:-1]), strict=True
    ):
        assert coarse.anchors == round(keep * fine.anchors)


@pytest.mark.parametrize("ablation", ["full", "base", "lad", "cbm", "lad-frozen"])
def test_unfolding_leaves_shared_tensors_and_finer_levels_untouched(
    ablation: str, tmp_path: Path
) -> None:
    config = replace(SEQUENTIAL, levels=replace(SEQUENTIAL.levels, ablation=ablation))
    t = trainer(config)
    hashes: list[dict[str, str]] = []

    class Watch(Silent):
        def on_step(self, info) -> None:
            if info.phase.startswith("unfold") and info.step in (1, info.steps):
                hashes.append(fingerprints(t))

    assert run_training(t, tmp_path, Watch(), lambda: False)
    assert len(hashes) == 6
    for later in hashes[1:]:
        assert all(later[name] == value for name, value in hashes[0].items() if name in later)
    assert t.model is not None
    changed = {
        "networks": t.model.part(0).networks["color_b2"].data,
        "codebook": t.model.part(0).codebook.data,
    }
    parent = t.model.part(1)
    moved = {k for k, v in changed.items() if not same(v, part_tensor(parent, k))}
    expected = {
        "full": {"networks", "codebook"},
        "base": set(),
        "lad": {"networks"},
        "cbm": {"codebook"},
        "lad-frozen": {"networks"},
    }
    assert moved == expected[ablation]
    assert t.model.part(0).codebook.shape[1] == (0 if ablation == "lad" else 4)


def same(a: torch.Tensor, b: torch.Tensor) -> bool:
    return a.shape == b.shape and torch.equal(a, b)


def part_tensor(part, kind: str) -> torch.Tensor:
    return part.networks["color_b2"].data if kind == "networks" else part.codebook.data


def fingerprints(t: Trainer) -> dict[str, str]:
    """Hashes of what all levels share and of the finest level."""
    assert t.model is not None
    names = ("lattice", "codes", "offsets", "log_scales", "residual", "table")
    tensors = {name: getattr(t.model, name) for name in names}
    finest = t.model.part(-1)
    tensors |= {f"finest {n}": w for n, w in finest.networks.items()}
    return {n: hashlib.sha256(v.detach().numpy().tobytes()).hexdigest() for n, v in tensors.items()}


def test_a_checkpoint_of_another_scene_is_refused(tmp_path: Path) -> None:
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))
    with pytest.raises(CheckpointError, match=r"scene: found a run of another scene.*--out"):
        run_training(trainer(points=90), tmp_path, Silent(), lambda: False)


def test_other_settings_are_refused_with_the_fields_that_differ(tmp_path: Path) -> None:
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))
    other = replace(JOINT, train=replace(JOINT.train, steps=31, seed=4))
    with pytest.raises(CheckpointError, match=r"train.seed, train.steps: found 0, 30, expected"):
        run_training(trainer(other), tmp_path, Silent(), lambda: False)


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))
    path = tmp_path / CHECKPOINT
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="expected a checkpoint; delete it"):
        run_training(trainer(), tmp_path, Silent(), lambda: False)


def test_a_full_disk_keeps_the_previous_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))
    before = (tmp_path / CHECKPOINT).read_bytes()

    def full(*args: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_file", full)
    with pytest.raises(SpaceError, match="No space left"):
        run_training(trainer(), tmp_path, Silent(), StopAfter(3))
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == [CHECKPOINT]


def test_too_little_disk_is_said_before_writing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=10)
    monkeypatch.setattr(checkpoint.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(SpaceError, match="found 10 bytes free"):
        run_training(trainer(), tmp_path, Silent(), StopAfter(1))
    assert not list(tmp_path.iterdir())


def test_passes_over_views_are_told_view_by_view(tmp_path: Path) -> None:
    t, told = trainer(JOINT), list[tuple[str, int, int]]()

    class Watch(Silent):
        def on_pass(self, what: str, done: int, views: int) -> None:
            told.append((what, done, views))

    assert run_training(t, tmp_path, Watch(), lambda: False)
    count = len(t.scene.train)
    assert {views for _, _, views in told} == {count}
    assert [done for _, done, _ in told] == list(range(1, count + 1)) * (len(told) // count)
    assert {what for what, _, _ in told} == {"weighing slots", "weighing values"}


def test_a_loss_that_is_not_finite_stops_with_step_view_and_tensor(tmp_path: Path) -> None:
    t = trainer()

    class Poison(Silent):
        def on_step(self, info) -> None:
            if info.step == 4:
                t.model.table.data[:] = float("nan")
                t.model.part(-1).networks["color_b2"].data[:] = float("nan")

    with pytest.raises(DivergedError, match=r"step 5: view \d+.png gives .*tensor: table"):
        run_training(t, tmp_path, Poison(), lambda: False)


def test_a_model_that_is_not_finite_does_not_replace_the_last_good_checkpoint(
    tmp_path: Path,
) -> None:
    t = trainer()
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
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))
    changed_state(tmp_path / CHECKPOINT, lambda state: state.update(format="other-2"))
    with pytest.raises(CheckpointError, match=r"format: found other-2, expected .*version that"):
        run_training(trainer(), tmp_path, Silent(), lambda: False)


def test_a_setting_that_only_the_other_version_knows_is_named(tmp_path: Path) -> None:
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))

    def add(state: dict) -> None:
        config = json.loads(state["config"])
        config["train"]["warmth"] = 3
        state["config"] = json.dumps(config)

    changed_state(tmp_path / CHECKPOINT, add)
    with pytest.raises(CheckpointError, match=r"train.warmth: found 3, expected None; repeat"):
        run_training(trainer(), tmp_path, Silent(), lambda: False)


def test_a_setting_that_the_other_version_did_not_know_was_at_its_default(tmp_path: Path) -> None:
    run_training(trainer(), tmp_path, Silent(), StopAfter(3))

    def remove(state: dict) -> None:
        config = json.loads(state["config"])
        del config["train"]["batch"]
        state["config"] = json.dumps(config)

    changed_state(tmp_path / CHECKPOINT, remove)
    other = replace(JOINT, train=replace(JOINT.train, batch=2))
    with pytest.raises(CheckpointError, match=r"train.batch: found 1, expected 2"):
        run_training(trainer(other), tmp_path, Silent(), lambda: False)
    assert run_training(trainer(), tmp_path, Silent(), lambda: False)


def test_the_full_model_is_kept_for_unfolding(tmp_path: Path) -> None:
    trained(JOINT, tmp_path)
    target = tmp_path / "next"
    target.mkdir()
    config = replace(JOINT, levels=replace(JOINT.levels, mode="sequential", steps=6))
    checkpoint.rewrite_config(tmp_path / FULL, target / CHECKPOINT, config)
    t = trainer(config)
    assert run_training(t, target, Silent(), lambda: False)
    assert [p.name for p in run.phases_of(config)][1:] == ["unfold L2", "unfold L1", "unfold L0"]
    assert t.model is not None and len(t.model.parts) == 4


def test_training_lowers_the_error(tmp_path: Path) -> None:
    errors: list[float] = []

    class Watch(Silent):
        def on_step(self, info) -> None:
            errors.append(info.loss)

    config = replace(JOINT, train=replace(JOINT.train, steps=120))
    assert run_training(trainer(config), tmp_path, Watch(), lambda: False)
    assert np.mean(errors[100:120]) < 0.8 * np.mean(errors[:5])
