"""Save and resume a run exactly: one safetensors file, written aside and renamed.

Tensors are model, optimizer moments and averages, growth statistics, mask logits and torch's random
state; the cursor, NumPy's random state, settings and the scene's identity are JSON in the file's
metadata. No pickle. A run that was resumed continues bit for bit on the CPU.
"""

import json
import shutil
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from gsynopsis.config import Config, config_from_json, config_to_json
from gsynopsis.errors import (
    CheckpointError,
    DivergedError,
    InputError,
    SettingError,
    SpaceError,
)
from gsynopsis.files import open_regular, published
from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.build import grid_resolutions, make_frame
from gsynopsis.model.encoding import grid_layout
from gsynopsis.training.context import TrainContext
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.regularize.exposure import Exposures
from gsynopsis.training.schema import (
    ANEW,
    MODEL_TENSORS,
    check_order,
    check_record,
    check_tensors,
    parse_record,
    random_states,
)
from gsynopsis.training.state import Progress, TrainState, new_state
from gsynopsis.training.step import non_finite

FORMAT = "gsynopsis-checkpoint-1"


def save_checkpoint(state: TrainState, path: Path) -> None:
    """Write everything that a resumed run needs; the previous file survives any failure.

    The file does not depend on how many processes train. All of them call this, one writes.

    Raises:
        SpaceError: the disk is full; the previous checkpoint is untouched.
        DivergedError: a parameter is not finite; the previous checkpoint is untouched.
        PeerError: the process that writes could not.
    """
    culprit = non_finite(state)  # brings home what is on a device
    if culprit:  # the next step would tell, but the last good file were gone
        raise DivergedError(
            f"step {state.progress.step}: tensor {culprit} has values that are not finite; "
            "the last checkpoint is kept"
        )
    model, config = state.model, state.context.config
    tensors = {f"model.{n}": getattr(model, n) for n in MODEL_TENSORS}
    parts = model.level_parts()
    for number, part in enumerate(parts):
        own = _part_tensors(part, part is parts[-1] or not config.levels.tied)
        tensors |= {f"part.{number}.{n}": t for n, t in own.items()}
    moments = state.moments | state.optimizer.tensors()
    tensors |= {f"adam.{n}": t for n, t in moments.items()}
    tensors |= {f"growth.{n}": t for n, t in _growth_tensors(state).items()}
    if state.mask_logits.numel():
        tensors["mask_logits"] = state.mask_logits
    if state.exposures is not None:
        tensors |= {f"exposure.{n}": t for n, t in state.exposures.tensors().items()}
    tensors["random"] = state.generator.get_state()
    record = {
        "format": FORMAT,
        "scene": state.context.scene.fingerprint(),
        "config": config_to_json(config),
        "cursor": asdict(state.progress),
        "numpy": state.rng.bit_generator.state,
        "grids": [part.grids for part in parts],
    }
    plain = {n: t.detach().cpu().contiguous() for n, t in tensors.items()}
    state.context.group.on_main(lambda: write_aside(plain, {"state": json.dumps(record)}, path))


def write_aside(tensors: Mapping[str, Tensor], metadata: dict[str, str], path: Path) -> None:
    """Save under a temporary name, flush to disk, rename; nothing half written remains.

    Raises:
        SpaceError: there is no room for it.
    """
    needed = sum(t.numel() * t.element_size() for t in tensors.values())
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise SpaceError(path, "checkpoint", found=f"{free} bytes free", expected=f"{needed} bytes")
    try:
        with published(path) as draft:
            save_file(dict(tensors), draft, metadata=metadata)
    except SafetensorError as error:
        raise SpaceError(path, "checkpoint", found=error, expected="to be written") from error


def load_state(context: TrainContext, path: Path) -> TrainState:
    """A training as a checkpoint holds it; its phase goes on with the optimizer's moments.

    Args:
        context: Of the same scene and settings.
        path: The checkpoint.

    Raises:
        CheckpointError: not a checkpoint, damaged, or of another scene, setting or version.
    """
    record, tensors = read_checkpoint(path)
    _check_identity(context, path, record)
    cursor = msgspec.convert(record["cursor"], Progress)
    check_order(path, cursor, context.scene.train)
    generator, rng = random_states(path, tensors.pop("random"), record["numpy"])
    tensors = {name: t.to(context.renderer.device) for name, t in tensors.items()}
    state = new_state(context, _model(context, record, tensors), generator, rng)
    state.progress, state.checkpoint = cursor, path
    state.statistics = _growth_statistics(context, _within("growth.", tensors))
    if "mask_logits" in tensors:
        state.mask_logits = nn.Parameter(tensors["mask_logits"])
    exposure = _within("exposure.", tensors)
    if context.config.train.exposure == "on":
        state.exposures = _exposures(path, exposure, context.scene.train)
    state.moments = _within("adam.", tensors)
    return state


def begin_from(context: TrainContext, source: Path, full: Path, target: Path) -> None:
    """Begin a training at the full model of another one, once its checkpoint is known to fit.

    Args:
        context: Of the same scene, and of other levels.
        source: State of the other training at the end of its full training.
        full: Copy of it to make.
        target: Checkpoint to make, of the settings of `context`.

    Raises:
        CheckpointError: the source is a link, not a checkpoint, damaged, or of another scene.
        SpaceError: there is no room for the copies.
    """
    record, tensors = read_checkpoint(source)
    changed = record | {"config": config_to_json(context.config)}
    _check_identity(context, source, changed)
    check_tensors(source, context.config, changed, tensors)
    write_aside(tensors, {"state": json.dumps(record)}, full)
    write_aside(tensors, {"state": json.dumps(changed)}, target)


def _within(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Tensors whose names begin so, without that beginning."""
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}


def _part_tensors(part: LevelPart, matrices: bool) -> dict[str, Tensor]:
    """A level's own tensors; tied matrices are those of the finest level."""
    own = {"mask": part.mask, "codebook": part.codebook, "log_gain": part.log_gain}
    weights = part.networks.items()
    return own | {f"networks.{n}": t for n, t in weights if matrices or t.ndim == 1}


def _growth_tensors(state: TrainState) -> dict[str, Tensor]:
    """The counters of every view of a batch, [B, …], or without the first axis for one view."""
    named: dict[str, Tensor] = {}
    for name in state.statistics[0].tensors() if state.statistics else ():
        own = torch.stack([place.tensors()[name] for place in state.statistics])
        rows = state.context.group.gather(own)
        named[name] = rows if len(rows) > 1 else rows[0]
    return named


def _growth_statistics(
    context: TrainContext, tensors: Mapping[str, Tensor]
) -> list[GrowthStatistics]:
    """This process's share of what `_growth_tensors` gave."""
    batch = context.config.train.batch
    own = context.group.shard(range(batch)) if tensors else ()
    return [
        GrowthStatistics(**{n: t.view(batch, -1)[place].clone() for n, t in tensors.items()})
        for place in own
    ]


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Record and tensors of a file, which are of the settings that it says.

    Raises:
        CheckpointError: not a checkpoint, damaged, or of settings that this version has not.
    """
    with _opened(path) as handle:
        record = _record(handle, path)
        # Cloned: matrix products depend in the last bit on how their operands are aligned.
        tensors = {n: handle.get_tensor(n).clone() for n in handle.keys()}  # noqa: SIM118
    check_tensors(path, recorded_config(record, path), record, tensors)
    return record, tensors


@contextmanager
def _opened(path: Path) -> Generator[Any]:
    """An open checkpoint: a regular file, not a link, which could lead out of the run."""
    try:
        with open_regular(path, links=False), safe_open(path, framework="pt") as handle:
            yield handle
    except (OSError, SafetensorError, InputError, RuntimeError, ValueError) as error:
        if isinstance(error, CheckpointError):
            raise
        found = error.found if isinstance(error, InputError) else error
        raise CheckpointError(path, found=found, expected="a checkpoint", advice=ANEW) from error


def _record(handle: Any, path: Path) -> dict[str, Any]:
    """The record in a checkpoint's metadata.

    Raises:
        CheckpointError: not a valid record, or of another format.
    """
    record = parse_record((handle.metadata() or {}).get("state", "{}"), path)
    if record.get("format") != FORMAT:
        raise CheckpointError(
            path,
            "format",
            found=record.get("format"),
            expected=FORMAT,
            advice="delete it to start again, or use the version that wrote it",
        )
    check_record(path, record)
    return record


def recorded_phase(path: Path) -> int:
    """Number of phases that a checkpoint has completed; -1 if there is no readable checkpoint."""
    try:
        with _opened(path) as handle:
            return int(_record(handle, path)["cursor"]["phase"])
    except CheckpointError:
        return -1


def recorded_config(record: Mapping[str, Any], path: Path) -> Config:
    """Settings of a checkpoint's run.

    Raises:
        CheckpointError: this version has no such settings.
    """
    try:
        return config_from_json(record["config"])
    except SettingError as error:
        raise CheckpointError(
            path,
            str(error.where).removeprefix("--"),
            found=error.found,
            expected=error.expected,
            advice=error.advice or "use the version that wrote it or choose another --out",
        ) from error


def changed_settings(then: Config, now: Config) -> dict[str, tuple[Any, Any]]:
    """Settings that differ, by dotted name: the former and the present value.

    Of other ways of making levels only the mode: their other settings have no counterpart.
    """
    return dict(_differences(asdict(then), asdict(now), ""))


def _check_identity(context: TrainContext, path: Path, record: Mapping[str, Any]) -> None:
    scene = context.scene.fingerprint()
    if record["scene"] != scene:
        raise CheckpointError(
            path,
            "scene",
            found=f"a run of another scene ({record['scene'][:12]})",
            expected=f"{context.scene.name} ({scene[:12]})",
            advice="choose another --out",
        )
    changed = changed_settings(recorded_config(record, path), context.config)
    if changed:
        raise CheckpointError(
            path,
            ", ".join(changed),
            found=", ".join(str(then) for then, _ in changed.values()),
            expected=", ".join(str(now) for _, now in changed.values()),
            advice="repeat the settings of the run or choose another --out",
        )


def _exposures(path: Path, tensors: Mapping[str, Tensor], views: tuple[int, ...]) -> Exposures:
    """Gains of the photos.

    Raises:
        CheckpointError: they are of another number of photos, or of an older version.
    """
    expected = {"log_gains": (len(views), 3), "visits": (len(views),)}
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if found != expected or any(t.dtype != torch.float32 for t in tensors.values()):
        names = ", ".join(f"{name} {list(shape)}" for name, shape in found.items()) or "nothing"
        wanted = f"gains of {len(views)} photos"
        raise CheckpointError(path, "exposure", found=names, expected=wanted, advice=ANEW)
    return Exposures(tensors, views)


def _differences(
    then: Mapping[str, Any], now: Mapping[str, Any], above: str
) -> Iterator[tuple[str, tuple[Any, Any]]]:
    for key in sorted(then.keys() & now.keys()):
        before, after = then[key], now[key]
        if isinstance(before, dict):
            yield from _differences(before, after, f"{above}{key}.")
        elif before != after:
            yield f"{above}{key}", (before, after)


def _model(
    context: TrainContext, record: Mapping[str, Any], tensors: Mapping[str, Tensor]
) -> AnchorModel:
    settings = context.config.model
    layout = grid_layout(grid_resolutions(settings), settings.table_log2)
    model = AnchorModel(make_frame(context.scene, settings), layout)
    model.set_lattice(tensors["model.lattice"])
    model.codes = tensors["model.codes"]
    for name in MODEL_TENSORS[2:]:
        setattr(model, name, nn.Parameter(tensors[f"model.{name}"]))
    for number, grids in enumerate(record["grids"]):
        own = _within(f"part.{number}.", tensors)
        part = LevelPart(own["mask"], grids, own["codebook"], _within("networks.", own))
        part.log_gain.data.copy_(own["log_gain"])
        model.parts.append(part)
    return model
