"""Coding of each kind of value."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from gsynopsis.container.layout import CodingId
from gsynopsis.errors import SettingError
from gsynopsis.records import Float32, LevelSet

Coding = Literal["raw", "compact"]


class Quantizer(NamedTuple):
    """A coding, and for stepped ones the smallest step worth taking.

    Attributes:
        coding: How values become bytes.
        least: The step; a longer one is taken where the numbers do not span a column.
        relative: `least` counts in root mean squares of all values of the kind in a level set.
    """

    coding: CodingId
    least: float = 0.0
    relative: bool = False


@dataclass(frozen=True)
class CodingPlan:
    """One coder for each kind of floating-point values."""

    networks: Quantizer
    codebook: Quantizer
    grid: Quantizer
    log_scales: Quantizer
    residual: Quantizer
    offsets: Quantizer


_FLOAT = Quantizer(CodingId.FLOAT)
PLANS: dict[Coding, CodingPlan] = {
    "raw": CodingPlan(_FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT),
    "compact": CodingPlan(
        networks=Quantizer(CodingId.CURVE8),
        codebook=Quantizer(CodingId.CURVE8, 0.1, relative=True),
        grid=Quantizer(CodingId.AFFINE8, 0.1, relative=True),
        log_scales=Quantizer(CodingId.AFFINE8, 0.02),
        residual=Quantizer(CodingId.CURVE8, 0.05, relative=True),
        offsets=Quantizer(CodingId.CURVE8, 0.02),
    ),
}
"""Steps of `compact` for values that are not rounded yet: each kind alone costs about 0.02 dB."""


SPLAT_PLANS: dict[Coding, CodingPlan] = {
    "raw": PLANS["raw"],
    "compact": CodingPlan(
        networks=_FLOAT,
        codebook=Quantizer(CodingId.AFFINE8, 2.0**-10),
        grid=_FLOAT,
        log_scales=Quantizer(CodingId.AFFINE16, 2.0**-5),
        residual=Quantizer(CodingId.AFFINE16, 2.0**-8),
        offsets=_FLOAT,
    ),
}
"""Coding plans of splats.

A column has steps of its own; these only bound the file where values are not rounded yet.
"""


def plan_for(levels: LevelSet, coding: Coding | CodingPlan) -> CodingPlan:
    """A plan by name or as given, with steps in the units of the level set's values.

    Raises:
        SettingError: there is no such name.
    """
    if not isinstance(coding, CodingPlan):
        if coding not in PLANS:
            raise SettingError("coding", found=coding, expected=" or ".join(PLANS))
        coding = (PLANS if levels.shared.degree is None else SPLAT_PLANS)[coding]
    shared = levels.shared
    values = {
        "networks": [w for level in levels.levels for w in level.networks.values()],
        "codebook": [level.codebook for level in levels.levels],
        "grid": shared.grids[: levels.levels[-1].grids],
        "log_scales": [shared.log_scales],
        "residual": [shared.residual],
        "offsets": [shared.offsets],
    }
    return CodingPlan(**{name: _scaled(getattr(coding, name), values[name]) for name in values})


def _scaled(coder: Quantizer, arrays: Sequence[Float32]) -> Quantizer:
    if not coder.relative:
        return coder
    total = sum(float(np.square(array, dtype=np.float64).sum()) for array in arrays)
    count = sum(array.size for array in arrays)
    size = (total / max(1, count)) ** 0.5
    return Quantizer(coder.coding, coder.least * size if np.isfinite(size) else 0.0)
