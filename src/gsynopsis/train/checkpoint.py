"""Save and resume a run exactly: one safetensors file, written aside and renamed.

Tensors are model, optimiser moments and means, growth statistics, mask logits and torch's random
state; the cursor, NumPy's random state, settings and the scene's identity are JSON in the file's
metadata. No pickle. A run that was resumed continues bit for bit on the CPU.
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from gsynopsis.config import Config, config_to_json
from gsynopsis.errors import CheckpointError, DivergedError, SpaceError
from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.build import grid_resolutions, make_frame
from gsynopsis.model.encoding import grid_layout
from gsynopsis.train.growth import GrowthStatistics
from gsynopsis.train.trainer import Cursor, Trainer

FORMAT = "gsynopsis-checkpoint-1"
MODEL_TENSORS = ("lattice", "codes", "offsets", "log_scales", "logits", "residual", "table")


def save_checkpoint(trainer: Trainer, path: Path) -> None:
    """Write everything a resumed run needs; the previous file survives any failure.

    The file does not depend on how many processes train. All of them call this, one writes.

    Raises:
        SpaceError: the disk is full; the previous checkpoint is untouched.
        DivergedError: a parameter is not finite; likewise.
        PeerError: the process that writes could not.
    """
    assert trainer.model is not None and trainer.optimiser is not None
    culprit = trainer.non_finite()
    if culprit is not None:  # the next step would find out, but the last good file were gone
        raise DivergedError(
            f"step {trainer.cursor.step}: tensor {culprit} has values that are not finite; "
            "the last checkpoint is kept"
        )
    tensors = {f"model.{n}": getattr(trainer.model, n) for n in MODEL_TENSORS}
    last, common = len(trainer.model.parts) - 1, trainer.config.levels.tied
    for number in range(last + 1):
        own = _part_tensors(trainer.model.part(number), number == last or not common)
        tensors |= {f"part.{number}.{n}": t for n, t in own.items()}
    tensors |= {f"adam.{n}": t for n, t in trainer.optimiser.tensors().items()}
    tensors |= {f"growth.{n}": t for n, t in _growth_tensors(trainer).items()}
    if trainer.mask_logits is not None:
        tensors["mask_logits"] = trainer.mask_logits
    tensors["random"] = trainer.generator.get_state()
    state = {
        "format": FORMAT,
        "scene": trainer.scene.fingerprint(),
        "config": config_to_json(trainer.config),
        "cursor": asdict(trainer.cursor),
        "numpy": trainer.rng.bit_generator.state,
        "grids": [trainer.model.part(k).grids for k in range(len(trainer.model.parts))],
    }
    plain = {n: t.detach().cpu().contiguous() for n, t in tensors.items()}
    trainer.world.lead(lambda: write_aside(plain, {"state": json.dumps(state)}, path))


def write_aside(tensors: Mapping[str, Tensor], metadata: dict[str, str], path: Path) -> None:
    """Save under a temporary name, flush to disk, rename; nothing half written remains.

    Raises:
        SpaceError: there is no room for it.
    """
    needed = sum(t.numel() * t.element_size() for t in tensors.values())
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise SpaceError(path, "checkpoint", found=f"{free} bytes free", expected=f"{needed} bytes")
    temporary = path.with_suffix(".tmp")
    try:
        save_file(dict(tensors), temporary, metadata=metadata)
        with temporary.open("rb") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    except (OSError, SafetensorError) as error:
        temporary.unlink(missing_ok=True)
        raise SpaceError(path, "checkpoint", found=error, expected="to be written") from error


def load_checkpoint(trainer: Trainer, path: Path) -> dict[str, Tensor]:
    """Fill a trainer from a file and return the optimiser's tensors for `Optimiser.load`.

    Args:
        trainer: A fresh trainer of the same scene and settings.
        path: The checkpoint.

    Raises:
        CheckpointError: not a checkpoint, damaged, or of another scene, setting or version.
    """
    state, tensors = read_checkpoint(path)
    _check_identity(trainer, path, state)
    device = trainer.renderer.device
    random = tensors.pop("random")
    tensors = {name: t.to(device) for name, t in tensors.items()}
    trainer.cursor = Cursor(**state["cursor"])
    trainer.rng.bit_generator.state = state["numpy"]
    trainer.generator.set_state(random)
    trainer.adopt(_model(trainer, state, tensors))
    growth = {n.removeprefix("growth."): t for n, t in tensors.items() if n.startswith("growth.")}
    trainer.statistics = _growth_statistics(trainer, growth)
    if "mask_logits" in tensors:
        trainer.mask_logits = nn.Parameter(tensors["mask_logits"])
    return {n.removeprefix("adam."): t for n, t in tensors.items() if n.startswith("adam.")}


def rewrite_config(source: Path, target: Path, config: Config) -> None:
    """Copy a checkpoint under other settings: what `unfold` goes on from.

    Raises:
        CheckpointError: the source is not a checkpoint or damaged.
        SpaceError: there is no room for the copy.
    """
    state, tensors = read_checkpoint(source)
    write_aside(tensors, {"state": json.dumps(state | {"config": config_to_json(config)})}, target)


def _part_tensors(part: LevelPart, matrices: bool) -> dict[str, Tensor]:
    """What a level owns; matrices that all have in common are those of the finest."""
    own = {"mask": part.mask, "codebook": part.codebook, "log_gain": part.log_gain}
    weights = part.networks.items()
    return own | {f"networks.{n}": t for n, t in weights if matrices or t.ndim == 1}


def _growth_tensors(trainer: Trainer) -> dict[str, Tensor]:
    """The counters of every view of a batch, [B, …], or without the first axis for one view."""
    found: dict[str, Tensor] = {}
    for name in trainer.statistics[0].tensors() if trainer.statistics else ():
        own = torch.stack([place.tensors()[name] for place in trainer.statistics])
        rows = trainer.world.gather(own)
        found[name] = rows if len(rows) > 1 else rows[0]
    return found


def _growth_statistics(trainer: Trainer, tensors: Mapping[str, Tensor]) -> list[GrowthStatistics]:
    """This process's share of what `_growth_tensors` gave."""
    batch = trainer.config.train.batch
    own = trainer.world.share(range(batch)) if tensors else ()
    return [
        GrowthStatistics(**{n: t.view(batch, -1)[place].clone() for n, t in tensors.items()})
        for place in own
    ]


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """State and tensors of a file.

    Raises:
        CheckpointError: not a checkpoint, or damaged.
    """
    try:
        with safe_open(path, framework="pt") as handle:
            metadata = handle.metadata() or {}
            state = json.loads(metadata.get("state", "{}"))
            # Cloned: matrix products depend in the last bit on how their operands are aligned.
            tensors = {n: handle.get_tensor(n).clone() for n in handle.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        raise CheckpointError(
            path, found=error, expected="a checkpoint", advice="delete it to start again"
        ) from error
    if state.get("format") != FORMAT:
        raise CheckpointError(
            path,
            "format",
            found=state.get("format"),
            expected=FORMAT,
            advice="delete it to start again, or use the version that wrote it",
        )
    return state, tensors


def _check_identity(trainer: Trainer, path: Path, state: Mapping[str, Any]) -> None:
    scene = trainer.scene.fingerprint()
    if state["scene"] != scene:
        raise CheckpointError(
            path,
            "scene",
            found=f"a run of another scene ({state['scene'][:12]})",
            expected=f"{trainer.scene.name} ({scene[:12]})",
            advice="choose another --out",
        )
    then, now = json.loads(state["config"]), json.loads(config_to_json(trainer.config))
    # A setting that the run's version did not have yet was at its default.
    differing = _differences(_filled(then, json.loads(config_to_json(Config()))), now, "")
    if differing:
        raise CheckpointError(
            path,
            ", ".join(name for name, _, _ in differing),
            found=", ".join(str(old) for _, old, _ in differing),
            expected=", ".join(str(new) for _, _, new in differing),
            advice="repeat the settings of the run or choose another --out",
        )


def _filled(given: Any, defaults: Any) -> Any:
    """Nested settings with what is missing taken from the defaults."""
    if not (isinstance(given, dict) and isinstance(defaults, dict)):
        return given
    return given | {
        name: _filled(given[name], value) if name in given else value
        for name, value in defaults.items()
    }


def changed_settings(state: Mapping[str, Any], config: Config) -> list[str]:
    """Names of the settings in which a checkpoint's run differs, dotted."""
    then, now = json.loads(state["config"]), json.loads(config_to_json(config))
    filled = _filled(then, json.loads(config_to_json(Config())))
    return [name for name, _, _ in _differences(filled, now, "")]


def _differences(then: Any, now: Any, where: str) -> list[tuple[str, Any, Any]]:
    if isinstance(then, dict) and isinstance(now, dict):
        found: list[tuple[str, Any, Any]] = []
        for key in sorted({*then, *now}):
            name = f"{where}.{key}" if where else key
            found += _differences(then.get(key), now.get(key), name)
        return found
    return [] if then == now else [(where, then, now)]


def _model(
    trainer: Trainer, state: Mapping[str, Any], tensors: Mapping[str, Tensor]
) -> AnchorModel:
    settings = trainer.config.model
    layout = grid_layout(grid_resolutions(settings), settings.table_log2)
    model = AnchorModel(make_frame(trainer.scene, settings), layout)
    model.set_lattice(tensors["model.lattice"])
    model.codes = tensors["model.codes"]
    for name in MODEL_TENSORS[2:]:
        setattr(model, name, nn.Parameter(tensors[f"model.{name}"]))
    for number, grids in enumerate(state["grids"]):
        prefix = f"part.{number}."
        own = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
        networks = {
            n.removeprefix("networks."): t for n, t in own.items() if n.startswith("networks.")
        }
        part = LevelPart(own["mask"], grids, own["codebook"], networks)
        part.log_gain.data.copy_(own["log_gain"])
        model.parts.append(part)
    return model
