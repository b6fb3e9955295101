"""Trained parameters by name, and their learning rates (methods.md §1.8)."""

from collections.abc import Mapping

from torch import nn

from gsynopsis.config import RateConfig
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel, LevelPart


def row_parameters(model: AnchorModel) -> dict[str, nn.Parameter]:
    """Parameters of single anchors, by name; empty tensors are left out."""
    named = {name: getattr(model, name) for name in ROW_PARAMETERS}
    return {name: p for name, p in named.items() if p.numel()}


def shared_parameters(model: AnchorModel) -> dict[str, nn.Parameter]:
    """Parameters that all levels share, by name; empty tensors are left out."""
    return row_parameters(model) | ({"table": model.table} if model.table.numel() else {})


def part_parameters(part: LevelPart, prefix: str, *, level_scale: bool) -> dict[str, nn.Parameter]:
    """One level's own parameters, by name; the prefix tells levels apart.

    Args:
        part: The level.
        prefix: Put before each name.
        level_scale: The level learns its scale.
    """
    named = {f"{prefix}{name}": p for name, p in part.networks.items()}
    if part.codebook.numel():
        named[f"{prefix}codebook"] = part.codebook
    if level_scale:
        named[f"{prefix}log_gain"] = part.log_gain
    return named


def level_parameters(model: AnchorModel) -> dict[str, nn.Parameter]:
    """All levels' own parameters; each name begins with the number of the first to have it."""
    named: dict[str, nn.Parameter] = {}
    for number, part in enumerate(model.level_parts()):
        own = part_parameters(part, f"{number}.", level_scale=True)
        known = {id(parameter) for parameter in named.values()}
        named |= {name: p for name, p in own.items() if id(p) not in known}
    return named


def rates_of(
    names: Mapping[str, nn.Parameter], rates: RateConfig, extent: float, free: bool
) -> dict[str, tuple[float, float]]:
    """Initial and final learning rates of parameters by their names.

    Args:
        names: The parameters.
        rates: The table.
        extent: Extent of the scene, world units.
        free: Values per anchor are those of the control `feature = "free"`.
    """
    extent = rates.unit_extent or extent
    kinds = {
        "offsets": (rates.offset[0] * extent, rates.offset[1] * extent),
        "log_scales": rates.scale,
        "logits": rates.logits,
        "residual": rates.free if free else rates.residual,
        "table": rates.grid,
        "codebook": rates.codebook,
        "log_gain": rates.gain,
        "mask_logits": rates.mask,
        "fuse": rates.fuse,
        "opacity": rates.opacity,
        "cov": rates.cov,
        "color": rates.color,
    }
    named = {}
    for name in names:
        kind = name.rsplit(".", 1)[-1]
        named[name] = kinds[kind] if kind in kinds else kinds[kind.split("_")[0]]
    return named
