"""More steps for a finished run: the full model goes on, levels are trained again.

The full model goes on from the end of its training, under the longer schedule; levels, which depend
on all of it, are made again. That is not the file that the longer training alone gives.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gsynopsis.config import Config, config_to_json
from gsynopsis.training.checkpoint import (
    changed_settings,
    read_checkpoint,
    recorded_config,
    write_aside,
)
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.loop import CHECKPOINT, FULL

STEPS = frozenset({"train.steps", "levels.steps"})
FOLLOWING = frozenset({"train.growth.threshold", "levels.prune_share", "levels.coding_loss"})
"""Settings that presets derive from the number of steps (`config/scene_rules.py`)."""


def extend_run(out: Path, scene: str, config: Config) -> str:
    """Turn the checkpoint of a run that had fewer steps into one of this training.

    Args:
        out: The run's folder; without a checkpoint nothing happens.
        scene: Fingerprint of the scene to train on.
        config: Settings of the training that is about to go on there.

    Returns:
        One line on the parts that are kept and those that are trained again; empty if there is
        nothing to do, or nothing can be done: then the checkpoint is unchanged, and loading it
        reports the mismatch.

    Raises:
        CheckpointError: the checkpoint is damaged, or its settings are unknown to this version.
        SpaceError: there is no room for another one.
    """
    path = out / CHECKPOINT
    if not path.exists():
        return ""
    record, tensors = read_checkpoint(path)
    old = recorded_config(record, path)
    changed = changed_settings(old, config).keys()
    before, now = old.train.steps, config.train.steps
    fewer = before > now or (before == now and old.levels.steps > config.levels.steps)
    same = record["scene"] == scene and changed & STEPS and changed <= STEPS | FOLLOWING
    if not same or fewer:
        return ""
    cursor = record["cursor"]
    levels = f"levels are made anew in {config.levels.steps:,} steps"
    if cursor["phase"] == 0:
        done = int(cursor["step"])
        _write(path, record, tensors, config, cursor)
        return f"more steps: {done:,} of {before:,} are kept, {now - done:,} follow; then {levels}"
    if not (out / FULL).exists():
        return ""
    record, tensors = read_checkpoint(out / FULL)
    cursor = record["cursor"]
    if now > before:
        cursor = cursor | {"phase": 0, "begun": True, "step": before}
        tensors |= _no_statistics(tensors, config)
    _write(path, record, tensors, config, cursor)
    more = f"{now - before:,} more follow" if now > before else "as they are"
    return f"more steps: the full model's {before:,} are kept, {more}; {levels}"


def _write(
    path: Path,
    record: Mapping[str, Any],
    tensors: Mapping[str, Tensor],
    config: Config,
    cursor: Mapping[str, Any],
) -> None:
    changed = {**record, "config": config_to_json(config), "cursor": dict(cursor)}
    write_aside(tensors, {"state": json.dumps(changed)}, path)


def _no_statistics(tensors: Mapping[str, Tensor], config: Config) -> dict[str, Tensor]:
    """Growth counters at zero, for each view of a batch."""
    anchors, slots = tensors["model.offsets"].shape[:2]
    empty = GrowthStatistics.zeros(anchors, slots, torch.device("cpu")).tensors()
    batch = config.train.batch
    rows = {n: torch.stack([t] * batch) if batch > 1 else t for n, t in empty.items()}
    return {f"growth.{name}": t for name, t in rows.items()}
