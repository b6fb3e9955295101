"""Whole runs in small: determinism, resume, nested levels, frozen shared tensors."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch
from safetensors import safe_open

from gsynopsis.config import Config, Sequential
from gsynopsis.container import encode
from gsynopsis.errors import DivergedError
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model.build import CODEBOOK_DIM, model_to_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.training import checkpoint
from gsynopsis.training import loop as run
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import CHECKPOINT, FULL, open_state, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.phases.joint import JointPhase
from gsynopsis.training.state import TrainState
from tests.tiny import half_size, tiny_config, tiny_scene

Work = Callable[[JointPhase, TrainState], None]


def averaged(config: Config, share: float) -> Config:
    return replace(config, train=replace(config.train, weight_average=share))


SEQUENTIAL = tiny_config(mode="sequential", steps=12)
JOINT = averaged(tiny_config(prune_share=0.03, coding_loss=0.05), 0.5)
TIED = averaged(tiny_config(prune_share=0.03, coding_loss=0.05, weights="tied"), 0.5)
JITTERED = half_size(JOINT)


def context(config: Config = JOINT, points: int = 120) -> TrainContext:
    return TrainContext(tiny_scene(points=points), config, make_renderer("cpu"), FilePacker())


def opened(out: Path, config: Config = JOINT, points: int = 120) -> TrainState:
    return open_state(context(config, points), out, Silent())


def result(t: TrainState) -> str:
    return hashlib.sha256(encode(model_to_levels(t.model, {}), "raw")).hexdigest()


class StopAfter:
    def __init__(self, asks: int) -> None:
        self.left = asks

    def __call__(self) -> bool:
        self.left -= 1
        return self.left <= 0


def trained_anew(config: Config, out: Path) -> TrainState:
    t = opened(out, config)
    assert run_training(t, out, Silent(), lambda: False)
    return t


@cache
def finished(config: Config) -> tuple[TrainState, dict[str, bytes]]:
    """A training to its end and the files it left, made once: it is the same each time."""
    with TemporaryDirectory() as folder:
        t = trained_anew(config, Path(folder))
        return t, {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def trained(config: Config, out: Path) -> TrainState:
    """A finished training, which no test changes; its files are put into a folder."""
    t, files = finished(config)
    for name, content in files.items():
        (out / name).write_bytes(content)
    return t


@pytest.mark.parametrize("config", [JOINT, SEQUENTIAL], ids=["joint", "sequential"])
def test_same_seed_same_bytes(config: Config, tmp_path: Path) -> None:
    assert result(trained_anew(config, tmp_path)) == result(finished(config)[0])


def test_another_seed_gives_another_result(tmp_path: Path) -> None:
    other = replace(JOINT, train=replace(JOINT.train, seed=1))
    assert result(finished(JOINT)[0]) != result(trained_anew(other, tmp_path))


@pytest.mark.parametrize(
    "config",
    [JOINT, SEQUENTIAL, TIED, JITTERED],
    ids=["joint", "sequential", "tied", "jittered"],
)
def test_a_run_stopped_again_and_again_ends_like_an_uninterrupted_one(
    config: Config, tmp_path: Path
) -> None:
    for stops in (7, 1, 16, 9, 13, 1000):
        t = opened(tmp_path, config)
        if run_training(t, tmp_path, Silent(), StopAfter(stops)):
            break
    assert result(t) == result(finished(config)[0])


def test_levels_with_tied_weights_have_the_same_matrices_in_model_checkpoint_and_file(
    tmp_path: Path,
) -> None:
    # Rounding would end with other parameters than those that the optimizer moved.
    exact = replace(TIED, levels=replace(TIED.levels, coding_loss=0))
    t = trained(exact, tmp_path)
    first, *others = t.model.level_parts()
    matrices = {name for name, weight in first.networks.items() if weight.ndim == 2}
    for part in others:
        for name, weight in first.networks.items():
            assert (part.networks[name] is weight) == (name in matrices)
    assert len({tuple(part.log_gain.tolist()) for part in (first, *others)}) == 4
    moved = {id(parameter) for parameter in t.optimizer.parameters()}
    assert all(id(w) in moved for part in (first, *others) for w in part.networks.values())
    assert len(moved) == len(t.optimizer.parameters())
    with safe_open(tmp_path / "checkpoint.safetensors", framework="pt") as handle:
        names = [name for name in handle.keys() if "networks." in name]  # noqa: SIM118
    held = [name.split(".") for name in names if name.startswith("part.")]
    assert {number for _, number, _, name in held if name in matrices} == {"3"}
    assert {number for _, number, _, name in held if name not in matrices} == set("0123")
    levels = model_to_levels(t.model, {})
    assert [levels.inherits(k) for k in range(4)] == [False, True, True, True]
    (tmp_path / "own").mkdir()
    separate = replace(TIED, levels=replace(TIED.levels, weights="separate"))
    own = trained(separate, tmp_path / "own")
    apart = model_to_levels(own.model, {})
    assert not any(apart.inherits(k) for k in range(4))


def test_levels_of_a_run_are_nested_and_grow(tmp_path: Path) -> None:
    t = trained(SEQUENTIAL, tmp_path)
    levels = model_to_levels(t.model, {}).levels
    counts = [level.anchors for level in levels]
    assert len(levels) == 4 and counts == sorted(counts) and counts[0] < counts[-1]
    assert [level.grids for level in levels] == [1, 2, 3, 4]


def test_a_phase_ends_with_the_average_of_its_last_part(tmp_path: Path) -> None:
    """The oracle: the plain mean of the weights after every step."""
    t, seen = opened(tmp_path, averaged(tiny_config(), 0.3)), list[dict[str, torch.Tensor]]()

    class Watch(Silent):
        def on_step(self, info) -> None:
            if info.phase == "joint" and info.step > 14:
                named = t.model.named_parameters()
                seen.append({name: value.detach().clone() for name, value in named})

    assert run_training(t, tmp_path, Watch(), lambda: False)
    assert len(seen) == 6
    moved = set[str]()
    for name, value in t.model.named_parameters():
        if name == "logits":
            continue  # the codebook's choice is made from them, and they are dropped
        each = torch.stack([step[name] for step in seen])
        assert torch.allclose(value, each.mean(dim=0), rtol=1e-5, atol=1e-7), name
        moved |= {name} if not torch.equal(value, each[-1]) else set()
    assert {"offsets", "log_scales", "table", "parts.0.networks.color_w1"} <= moved


def test_weights_are_not_averaged_where_levels_split_off_later(tmp_path: Path) -> None:
    t = opened(tmp_path, averaged(tiny_config(), 1.0))
    run_training(t, tmp_path, Silent(), StopAfter(29))
    assert t.progress.phase == 0
    assert not any("average" in name for name in t.optimizer.tensors())


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
    t = opened(tmp_path, config)
    hashes: list[dict[str, str]] = []

    class Watch(Silent):
        def on_step(self, info) -> None:
            if info.phase.startswith("unfold") and info.step in (1, info.steps):
                hashes.append(fingerprints(t))

    assert run_training(t, tmp_path, Watch(), lambda: False)
    assert len(hashes) == 6
    for later in hashes[1:]:
        assert all(later[name] == value for name, value in hashes[0].items() if name in later)
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
    assert t.model.part(0).codebook.shape[1] == (0 if ablation == "lad" else CODEBOOK_DIM)


def same(a: torch.Tensor, b: torch.Tensor) -> bool:
    return a.shape == b.shape and torch.equal(a, b)


def part_tensor(part, kind: str) -> torch.Tensor:
    return part.networks["color_b2"].data if kind == "networks" else part.codebook.data


def fingerprints(t: TrainState) -> dict[str, str]:
    """Hashes of what all levels share and of the finest level."""
    names = ("lattice", "codes", "offsets", "log_scales", "residual", "table")
    tensors = {name: getattr(t.model, name) for name in names}
    finest = t.model.part(-1)
    tensors |= {f"finest {n}": w for n, w in finest.networks.items()}
    return {n: hashlib.sha256(v.detach().numpy().tobytes()).hexdigest() for n, v in tensors.items()}


def test_passes_over_views_are_told_view_by_view(tmp_path: Path) -> None:
    t, told = opened(tmp_path), list[tuple[str, int, int]]()

    class Watch(Silent):
        def on_pass(self, what: str, done: int, views: int) -> None:
            told.append((what, done, views))

    assert run_training(t, tmp_path, Watch(), lambda: False)
    count = len(t.context.scene.train)
    assert {views for _, _, views in told} == {count}
    assert [done for _, done, _ in told] == list(range(1, count + 1)) * (len(told) // count)
    assert {what for what, _, _ in told} == {"weighing slots", "weighing values"}


def test_a_loss_that_is_not_finite_stops_with_step_view_and_tensor(tmp_path: Path) -> None:
    t = opened(tmp_path)

    class Poison(Silent):
        def on_step(self, info) -> None:
            if info.step == 4:
                t.model.table.data[:] = float("nan")
                t.model.part(-1).networks["color_b2"].data[:] = float("nan")

    with pytest.raises(DivergedError, match=r"step 5: view \d+.png gives .*tensor: table"):
        run_training(t, tmp_path, Poison(), lambda: False)


def test_the_full_model_is_kept_for_unfolding(tmp_path: Path) -> None:
    trained(JOINT, tmp_path)
    target = tmp_path / "next"
    target.mkdir()
    config = replace(JOINT, levels=Sequential(steps=6))
    full = tmp_path / FULL
    checkpoint.begin_from(context(config), full, target / FULL, target / CHECKPOINT)
    t = opened(target, config)
    assert run_training(t, target, Silent(), lambda: False)
    assert [p.name for p in run.phases_of(config)][1:] == ["unfold L2", "unfold L1", "unfold L0"]
    assert len(t.model.parts) == 4


def test_training_lowers_the_error(tmp_path: Path) -> None:
    errors: list[float] = []

    class Watch(Silent):
        def on_step(self, info) -> None:
            errors.append(info.loss)

    config = replace(JOINT, train=replace(JOINT.train, steps=120))
    assert run_training(opened(tmp_path, config), tmp_path, Watch(), lambda: False)
    assert np.mean(errors[100:120]) < 0.8 * np.mean(errors[:5])


def test_what_stands_between_the_steps_is_training_time_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ranking when levels split off, sensitivity and rounding at the end."""
    spent = 0.0
    begin, end = JointPhase.begin, JointPhase.end

    def slowly(
        phase: JointPhase, state: TrainState, work: Callable[..., None], cost: float
    ) -> None:
        nonlocal spent
        spent += cost
        work(phase, state)

    monkeypatch.setattr(JointPhase, "begin", lambda p, s: slowly(p, s, begin, 1000.0))
    monkeypatch.setattr(JointPhase, "end", lambda p, s: slowly(p, s, end, 500.0))
    monkeypatch.setattr(run.time, "monotonic", lambda: spent)
    cursor = trained_anew(JOINT, tmp_path).progress
    assert (cursor.seconds, cursor.phase_seconds) == (1500.0, {"full": 0.0, "joint": 1500.0})
