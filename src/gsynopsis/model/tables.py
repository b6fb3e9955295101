"""Data that decoding a level for a camera reads, and what it makes.

Letters: N anchors, V of them visible, K slots, C codebook rows, G rendered Gaussians.
"""

import math
from dataclasses import dataclass

from torch import Tensor

from gsynopsis.model.encoding import GridLayout
from gsynopsis.records import HEAD_NAMES
from gsynopsis.render.base import Gaussians, TrainingFocals

WEIGHTS = tuple(f"{head}_{part}" for head in HEAD_NAMES for part in ("w1", "b1", "w2", "b2"))
"""Names of the heads' weights, in the order of the kernels."""


@dataclass(frozen=True)
class SlotTables:
    """Tensors of all anchors beside features.

    Attributes:
        positions: [N, 3], world units.
        log_scales: [N, 6], of the offsets and of the Gaussians.
        offsets: [N, K, 3], in units of the offset scales.
        live: [N, K] bool, slots that may be rendered.
        log_gain: [3], added to the logarithm of every Gaussian's scales.
    """

    positions: Tensor
    log_scales: Tensor
    offsets: Tensor
    live: Tensor
    log_gain: Tensor


@dataclass(frozen=True)
class HeadInputs:
    """Inputs of the heads.

    Attributes:
        rows: Visible anchors, int64 [V], strictly ascending.
        positions: [N, 3], world units.
        coordinates: [N, 3] in [0, 1], where grids are sampled.
        layout: The grids that are sampled.
        table: Their rows; may hold more grids.
        logits: [N, C] while the choice of a codebook row is learnt, else [N, 0].
        codes: int64 [N] once it is frozen; used where there are no logits.
        codebook: [C, D]; C may be 0.
        residual: [N, R]; R may be 0.
    """

    rows: Tensor
    positions: Tensor
    coordinates: Tensor
    layout: GridLayout
    table: Tensor
    logits: Tensor
    codes: Tensor
    codebook: Tensor
    residual: Tensor


@dataclass(frozen=True)
class ViewInput:
    """Camera position for the heads' direction and distance inputs.

    Attributes:
        position: World units [3].
        extent: Unit of distance, world units.
        low: Smaller distances count as this, in that unit; a float32 value.
        high: Larger distances count as this, in that unit; a float32 value.
    """

    position: tuple[float, float, float]
    extent: float
    low: float = 0.0
    high: float = math.inf


@dataclass(frozen=True)
class LevelInputs:
    """All that native kernels decode a level from.

    Attributes:
        tables: Of all anchors.
        heads: Of the anchors in view.
        view: The camera's place.
        weights: Those of `WEIGHTS`, in that order.
        focals: See `Gaussians.focals`.
    """

    tables: SlotTables
    heads: HeadInputs
    view: ViewInput
    weights: tuple[Tensor, ...]
    focals: TrainingFocals | None


@dataclass(frozen=True)
class Assembled:
    """The rendered slots as Gaussians, their flat slots row · K + slot [G], and tanh [V, K]."""

    gaussians: Gaussians
    slots: Tensor
    opacity: Tensor


@dataclass(frozen=True)
class Decoded:
    """The Gaussians of one view and where they come from.

    Attributes:
        gaussians: G Gaussians, the live slots with positive opacity of visible anchors.
        anchors: Visible anchors, rows of the model, int64 [V].
        slots: Of each Gaussian its flat slot, row · K + slot, int64 [G].
        opacity: Head output of all slots of visible anchors, [V, K] in (-1, 1), without gradient.
    """

    gaussians: Gaussians
    anchors: Tensor
    slots: Tensor
    opacity: Tensor
