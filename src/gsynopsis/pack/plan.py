"""Which coding each kind of value gets."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from gsynopsis.errors import SettingError
from gsynopsis.pack.layout import CodingId

Coding = Literal["raw", "compact"]


class Coder(NamedTuple):
    """A coding, and for affine ones the smallest step worth taking."""

    coding: CodingId
    least: float = 0.0


@dataclass(frozen=True)
class CodingPlan:
    """One coder for each kind of floating-point values."""

    networks: Coder
    codebook: Coder
    grid: Coder
    log_scales: Coder
    residual: Coder
    offsets: Coder


_FLOAT, _HALF, _EIGHT = (
    Coder(CodingId.FLOAT),
    Coder(CodingId.HALF),
    Coder(CodingId.AFFINE8),
)
PLANS: dict[Coding, CodingPlan] = {
    "raw": CodingPlan(_FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT),
    "compact": CodingPlan(_HALF, _HALF, _HALF, _EIGHT, _EIGHT, _EIGHT),
}


def plan_of(coding: Coding | CodingPlan) -> CodingPlan:
    """A plan by name, or itself.

    Raises:
        SettingError: there is no such name.
    """
    if isinstance(coding, CodingPlan):
        return coding
    if coding not in PLANS:
        raise SettingError("coding", found=coding, expected=" or ".join(PLANS))
    return PLANS[coding]
