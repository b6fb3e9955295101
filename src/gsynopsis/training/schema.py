"""The schema of a checkpoint: its record, and every tensor's type and shape under its settings.

A checkpoint may come from anyone, so nothing of it is used before it is checked here. The record
says by which settings it was trained; those say which tensors there are. Only the number of anchors
is the file's own, and the tensors must agree on it.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

import msgspec
import numpy as np
import torch
from msgspec import Meta
from torch import Tensor

from gsynopsis.config import Config, Joint
from gsynopsis.config.mismatch import mismatch
from gsynopsis.errors import CheckpointError
from gsynopsis.model.build import CODEBOOK_DIM, FREE_WIDTH, FUSE_WIDTHS, grid_resolutions
from gsynopsis.model.encoding import GridLayout, grid_layout
from gsynopsis.model.lattice import KEY_LIMIT
from gsynopsis.records import network_shapes
from gsynopsis.training.state import Progress

ANEW = "delete it to start again"
MODEL_TENSORS = ("lattice", "codes", "offsets", "log_scales", "logits", "residual", "table")
GROWTH_TENSORS = ("gradient", "drawn", "opacity", "visits")
RECORD_MOST = 1 << 22
"""Characters of a record: the views that are still to come are the most of it."""
Kind = tuple[torch.dtype, tuple[int, ...]]


class CheckpointRecord(msgspec.Struct, frozen=True, kw_only=True):
    """JSON record of a checkpoint, beside its tensors."""

    format: str
    scene: str
    config: str
    cursor: Progress
    numpy: dict[str, Any]
    grids: Annotated[list[Annotated[int, Meta(ge=0, le=12)]], Meta(min_length=1, max_length=8)]


def parse_record(text: str, path: Path) -> dict[str, Any]:
    """The JSON object of a checkpoint.

    Raises:
        CheckpointError: it is none, or has numbers that are not finite.
    """
    try:
        if len(text) > RECORD_MOST:
            raise ValueError(f"{len(text):,} characters")
        record = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        expected = f"a JSON object of at most {RECORD_MOST:,} characters"
        raise CheckpointError(path, "state", found=error, expected=expected, advice=ANEW) from error
    if not isinstance(record, dict):
        found = type(record).__name__
        raise CheckpointError(path, "state", found=found, expected="a JSON object", advice=ANEW)
    return record


def check_record(path: Path, record: Mapping[str, Any]) -> None:
    """A record has all that it has to, of the right types.

    Raises:
        CheckpointError: it has not; the message names the field.
    """
    try:
        msgspec.convert(record, CheckpointRecord)
    except UnicodeEncodeError as error:
        _refused(path, "state", error, "text without halves of surrogate pairs")
    except msgspec.ValidationError as error:
        wrong = mismatch(error)
        raise CheckpointError(
            path, wrong.name or "state", found=wrong.found, expected=wrong.expected, advice=ANEW
        ) from error


def check_tensors(
    path: Path, config: Config, record: Mapping[str, Any], tensors: Mapping[str, Tensor]
) -> None:
    """All tensors are there, of the types and shapes that the settings give them, and finite.

    Args:
        path: Of the checkpoint, for the message.
        config: Settings of its training.
        record: Checked.
        tensors: Of the file, by name.

    Raises:
        CheckpointError: one is not; the message names it.
    """
    cursor, grids = msgspec.convert(record["cursor"], Progress), list[int](record["grids"])
    _check_levels(path, config, cursor, grids)
    expected = dict(_expected(config, cursor, grids, tensors))
    for name, (dtype, shape) in expected.items():
        if name not in tensors:
            _refused(path, name, "no such tensor", _told(dtype, shape))
        found = tensors[name].dtype, tuple(tensors[name].shape)
        if found != (dtype, shape):
            _refused(path, name, _told(*found), _told(dtype, shape))
    for name, tensor in tensors.items():
        if name not in expected and not name.startswith(("adam.", "exposure.")):
            _refused(path, name, "a tensor of this name", "none under these settings")
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            _refused(path, name, "values that are not finite", "finite ones")
    _check_values(path, tensors)


def check_order(path: Path, cursor: Progress, views: Sequence[int]) -> None:
    """Views that are still to come are among those that are trained on.

    Raises:
        CheckpointError: they are not.
    """
    other = set(cursor.order) - set(views)
    if other:
        _refused(path, "cursor.order", f"view {min(other)}", f"one of {len(views)} photos")


def random_states(
    path: Path, torch_state: Tensor, numpy_state: Mapping[str, Any]
) -> tuple[torch.Generator, np.random.Generator]:
    """Both random generators in their saved states.

    Raises:
        CheckpointError: there is no such state.
    """
    generator, rng = torch.Generator(), np.random.default_rng()
    try:
        generator.set_state(torch_state)
        rng.bit_generator.state = dict(numpy_state)
    except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
        expected = "states of random generators"
        raise CheckpointError(
            path, "random", found=error, expected=expected, advice=ANEW
        ) from error
    return generator, rng


def _expected(
    config: Config, cursor: Progress, grids: Sequence[int], tensors: Mapping[str, Tensor]
) -> Iterator[tuple[str, Kind]]:
    """Names, types and shapes of all tensors but the optimizer's and the exposure's."""
    model = config.model
    layout = grid_layout(grid_resolutions(model), model.table_log2)
    count, slots = len(_rows(tensors)), model.slots
    yield "random", (torch.uint8, tuple(torch.Generator().get_state().shape))
    shapes = _model_shapes(config, count, layout, tensors)
    whole = ("lattice", "codes")
    for name, shape in shapes.items():
        yield f"model.{name}", (torch.int64 if name in whole else torch.float32, shape)
    for number in range(len(grids)):
        matrices = number == len(grids) - 1 or not config.levels.tied
        part = _part_shapes(config, layout, grids[number], tensors, f"part.{number}.")
        yield f"part.{number}.mask", (torch.bool, (count, slots))
        for name, shape in part.items():
            if matrices or len(shape) == 1 or not name.startswith("networks."):
                yield f"part.{number}.{name}", (torch.float32, shape)
    first = (config.train.batch,) if config.train.batch > 1 else ()
    if cursor.phase == 0 and cursor.begun:
        for name in GROWTH_TENSORS:
            rows = count * slots if name in GROWTH_TENSORS[:2] else count
            yield f"growth.{name}", (torch.float32, (*first, rows))
    masks = not isinstance(config.levels, Joint) and cursor.phase > 0 and cursor.begun
    if masks and count:
        yield "mask_logits", (torch.float32, (count, slots))


def _model_shapes(
    config: Config, count: int, layout: GridLayout, tensors: Mapping[str, Tensor]
) -> dict[str, tuple[int, ...]]:
    """Shapes of what all levels share; the choice of codebook rows is soft, or frozen."""
    model = config.model
    free = model.feature == "free"
    codes = 0 if free else model.codebook
    logits = tensors.get("model.logits")
    frozen = logits is not None and not logits.numel() and bool(codes and count)
    empty = (0, 0) if logits is not None and logits.shape == (0, 0) else (count, 0)
    return {
        "lattice": (count, 3),
        "codes": (count,) if frozen else (0,),
        "offsets": (count, model.slots, 3),
        "log_scales": (count, 6),
        "logits": empty if frozen or not codes else (count, codes),
        "residual": (count, FREE_WIDTH if free else model.residual),
        "table": (layout.rows, layout.features),
    }


def _part_shapes(
    config: Config, layout: GridLayout, grids: int, tensors: Mapping[str, Tensor], prefix: str
) -> dict[str, tuple[int, ...]]:
    """Shapes of a level's own tensors beside its mask; without local features, no codebook."""
    model = config.model
    free = model.feature == "free"
    codes = 0 if free else model.codebook
    book = tensors.get(f"{prefix}codebook")
    without = not codes or (book is not None and book.shape == (codes, 0))
    dims = 0 if without else CODEBOOK_DIM
    width = grids * layout.features + dims + (FREE_WIDTH if free else model.residual)
    fuse = FUSE_WIDTHS if model.fusion == "mlp" and not free else None
    networks = network_shapes(width, model.slots, model.hidden, fuse)
    own = {"codebook": (codes, dims), "log_gain": (3,)}
    return own | {f"networks.{name}": shape for name, shape in networks.items()}


def _check_levels(path: Path, config: Config, cursor: Progress, grids: Sequence[int]) -> None:
    """Check the levels and their grids against the point that the training has reached."""
    levels, count = config.levels, config.levels.count
    if isinstance(levels, Joint):
        phases, steps = 2, (config.train.steps, levels.steps)
        parts = {count} if cursor.phase > 1 or (cursor.phase and cursor.begun) else {1, count}
    else:
        phases, steps = count, (config.train.steps, *[levels.steps] * (count - 1))
        parts = {min(max(cursor.phase + (cursor.begun and cursor.phase > 0), 1), count)}
    if cursor.phase > phases:
        _refused(path, "cursor.phase", cursor.phase, f"at most {phases}")
    if cursor.step > (*steps, 0)[cursor.phase]:
        _refused(path, "cursor.step", cursor.step, f"at most {(*steps, 0)[cursor.phase]}")
    if len(grids) not in parts:
        _refused(path, "grids", f"{len(grids)} levels", " or ".join(map(str, sorted(parts))))
    most = len(grid_resolutions(config.model))
    if list(grids) != sorted(grids) or max(grids) > most or (levels.tied and min(grids) < most):
        _refused(path, "grids", list(grids), f"rising numbers, at most {most}")
    sizes = cursor.trained_bytes
    if sizes is not None and (len(sizes) != count or len({len(row) for row in sizes}) != 1):
        _refused(path, "cursor.trained_bytes", f"{len(sizes)} rows", f"{count} alike")


def _check_values(path: Path, tensors: Mapping[str, Tensor]) -> None:
    lattice, codes = tensors["model.lattice"], tensors["model.codes"]
    rows = tensors["part.0.codebook"].shape[0]
    if len(lattice) and not -KEY_LIMIT <= int(lattice.min()) <= int(lattice.max()) < KEY_LIMIT:
        _refused(path, "model.lattice", "cells far outside", f"within {KEY_LIMIT:,}")
    if len(codes) and not 0 <= int(codes.min()) <= int(codes.max()) < rows:
        _refused(path, "model.codes", "a row that is not there", f"0 to {rows - 1}")


def _rows(tensors: Mapping[str, Tensor]) -> Tensor:
    """The tensor whose length is the number of anchors."""
    lattice = tensors.get("model.lattice")
    return torch.zeros(0) if lattice is None or not lattice.ndim else lattice


def _told(dtype: torch.dtype, shape: Sequence[int]) -> str:
    return f"{str(dtype).removeprefix('torch.')}{list(shape)}"


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} in JSON")


def _refused(path: Path, name: str, found: object, expected: object) -> NoReturn:
    raise CheckpointError(path, name, found=found, expected=expected, advice=ANEW)
