"""Tables of learning rates, initial → final, log-linear over the schedule (methods.md §1.8)."""

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

RateTable: TypeAlias = Literal["paper", "ours"]
Rates: TypeAlias = tuple[float, float]
"""Initial and final learning rate."""


@dataclass(frozen=True)
class RateConfig:
    """Learning rates by parameter; defaults are those of Scaffold-GS and HAC."""

    offset: Rates = (0.01, 1e-4)
    """Times the scene extent."""
    unit_extent: float = 0.0
    """Extent that every scene counts as in offsets' rates and the volume loss, so that a training
    does not depend on the world's unit (ours); 0: its own (Scaffold-GS)."""
    scale: Rates = (0.007, 0.007)
    logits: Rates = (0.01, 1e-4)
    codebook: Rates = (0.0075, 7.5e-4)
    residual: Rates = (0.0075, 7.5e-4)
    free: Rates = (0.0075, 0.0075)
    grid: Rates = (0.005, 1e-5)
    fuse: Rates = (0.005, 1e-5)
    opacity: Rates = (0.002, 2e-5)
    cov: Rates = (0.004, 0.004)
    color: Rates = (0.008, 5e-5)
    gain: Rates = (0.005, 5e-4)
    mask: Rates = (0.01, 0.01)


PAPER = RateConfig()
OURS = replace(
    PAPER,
    offset=(0.01, 0.002),
    unit_extent=5.0,
    scale=(0.007, 0.0028),
    residual=(0.015, 0.015),
    free=(0.015, 0.015),
    grid=(0.02, 0.006),
    opacity=(0.002, 4e-4),
    cov=(0.004, 0.0016),
    color=(0.008, 8e-4),
)
"""Rates that fall little, because averaging the last weights settles what they leave, and that of
values per anchor not at all (ours). That of grids is for `model.grids`: the presets have none."""
RATES: dict[RateTable, RateConfig] = {"paper": PAPER, "ours": OURS}
