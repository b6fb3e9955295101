"""Shared values rounded before they are packed, each kind as finely as its sensitivity asks (ours).

The plan's steps fit no scene in particular. Where the sensitivity of images to every value is
known, steps are chosen for the scene. The caller asks for a loss in dB; each kind of values causes
a part of it in proportion to their number, which takes the fewest bytes. The same holds for levels:
finer levels have less sensitive values and longer steps. The coding finds the steps again from the
values.

Offsets count in scales of their anchor, and any scales will do as long as the products stay. So
they become powers of √e, the same along all three axes: few enough to take little room, larger
where images are less sensitive to offsets.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.coding import Quantizer, plan_for
from gsynopsis.container.error_compensation import compensate_errors
from gsynopsis.container.layout import CodingId
from gsynopsis.container.values import OCTAVES, decode_values, encode_values
from gsynopsis.records import Float32, LevelSet, Sensitivity

SCALE_EXPONENT = 0.35
"""Exponent with which the offsets' scales follow the sensitivity; 0 keeps those of training.

A half would be best on the training views.
"""
STEP_EXPONENT = 0.35
"""Exponent with which steps fall as values become more sensitive; see `SCALE_EXPONENT`."""
GRAIN = 0.5
"""Logarithms of the scales are multiples of this."""
REACH = 7.5
"""Largest offset in scales of its anchor; the numbers of the coding end at 7.6."""
PROBES = 12
"""Halvings of the span in the search for a step."""
SPAN = float(-OCTAVES[0])
"""Powers of two on either side of the plan's step that the search covers.

The coding finds none that is shorter.
"""


def rounded(levels: LevelSet, sensitivity: Sensitivity, loss: float) -> LevelSet:
    """The same levels with shared values that the compact coding holds exactly.

    Args:
        levels: What training left; not modified.
        sensitivity: Of its values.
        loss: What the images may lose by all of it, dB > 0, about: a step that would be too
            short for 256 numbers is longer, and loses more.
    """
    if not len(levels.shared.lattice):
        return levels
    levels, sensitivity = gauge_fix_scales(levels, sensitivity)
    shared, finest = levels.shared, levels.levels[-1]
    plan, live, used = plan_for(levels, "compact"), finest.mask, finest.grids
    each, (rows, slots) = loss / _count(levels), zip(*_of_levels(levels), strict=True)

    def by_level(
        places: Sequence[Any],
        values: Float32,
        weights: Float32,
        coder: Quantizer,
        coupling: Float32 | None = None,
    ) -> Float32:
        found = values.copy()
        steps = _steps([values[p] for p in places], [weights[p] for p in places], each, coder)
        for place, step in zip(places, steps, strict=True):
            if coupling is None:
                found[place] = _in_steps(coder.coding, values[place], step)
            else:
                found[place] = compensate_errors(coder.coding, values[place], step, coupling[place])
        return found

    own = by_level(rows, shared.log_scales[:, 3:], sensitivity.log_scales[:, 3:], plan.log_scales)
    offsets = shared.offsets * live[:, :, None]
    steps = _steps(shared.grids[:used], sensitivity.grids[:used], each, plan.grid)
    grids = [_in_steps(plan.grid.coding, g, s) for g, s in zip(shared.grids, steps, strict=False)]
    changed = replace(
        shared,
        offsets=by_level(slots, offsets, sensitivity.offsets, plan.offsets),
        log_scales=np.concatenate([shared.log_scales[:, :3], own], axis=1),
        residual=by_level(
            rows, shared.residual, sensitivity.residual, plan.residual, sensitivity.coupling
        ),
        grids=(*grids, *shared.grids[used:]),
    )
    return replace(levels, shared=changed)


def gauge_fix_scales(levels: LevelSet, sensitivity: Sensitivity) -> tuple[LevelSet, Sensitivity]:
    """The same positions of Gaussians by other scales of offsets, and the sensitivity of these.

    The three scales of an anchor are one afterwards. Their logarithms' mean over all live slots
    stays, but for rounding and for anchors that need a larger one to reach their farthest slot.
    """
    shared, live = levels.shared, levels.levels[-1].mask
    before = shared.log_scales[:, :3].astype(np.float64)
    count = live.sum(axis=1)[:, None]
    weight = (sensitivity.offsets * live[:, :, None]).sum(axis=1) / count / np.exp(2 * before)
    weight = np.maximum(weight, weight[weight > 0].min(initial=np.inf))
    wanted = (1 - 2 * SCALE_EXPONENT) * before
    if np.isfinite(weight).all():
        wanted -= SCALE_EXPONENT * np.log(weight)
    wanted += np.average(before - wanted, weights=np.broadcast_to(count, before.shape))
    wanted = wanted.mean(axis=1, keepdims=True)
    far = np.abs(shared.offsets * live[:, :, None]).max(axis=1)
    least = before + np.log(np.maximum(far, np.finfo(np.float32).tiny) / REACH)
    least = least.max(axis=1, keepdims=True)
    after = GRAIN * np.maximum(np.rint(wanted / GRAIN), np.ceil(least / GRAIN))
    factor = np.exp(before - after)[:, None]
    log_scales = shared.log_scales.copy()
    log_scales[:, :3] = after
    offsets = (shared.offsets * factor).astype(np.float32)
    moved = replace(levels, shared=replace(shared, log_scales=log_scales, offsets=offsets))
    return moved, replace(sensitivity, offsets=sensitivity.offsets / factor**2)


def _of_levels(levels: LevelSet) -> Iterator[tuple[slice, tuple[NDArray[np.int64], ...]]]:
    """Rows first present in each level: its anchors, and slots of any anchors, as indices."""
    first = 0
    for number, level in enumerate(levels.levels):
        yield slice(first, level.anchors), np.nonzero(level.mask & ~levels.before(number))
        first = level.anchors


def _count(levels: LevelSet) -> int:
    """Values that are rounded."""
    shared, finest = levels.shared, levels.levels[-1]
    grids = [grid.size for grid in shared.grids[: finest.grids]]
    return 3 * (finest.live + finest.anchors) + shared.residual.size + sum(grids)


def _steps(
    arrays: Sequence[Float32], weights: Sequence[Float32], each: float, coder: Quantizer
) -> list[float]:
    """The longest steps in which arrays of [rows, columns] lose at most `each` per value.

    Args:
        arrays: Arrays to round, one by one: the more sensitive, the shorter the step.
        weights: Their sensitivity.
        each: Loss that each value may cause on average, dB.
        coder: Their coding, and the step around which to search.
    """
    sizes = [array.size for array in arrays]
    means = np.array([w.mean(dtype=np.float64) if w.size else 0.0 for w in weights])
    mean = float(np.dot(means, sizes)) / max(1, sum(sizes))
    shares = [(m / mean if m else 1.0) ** -STEP_EXPONENT for m in means]

    def loss(step: float) -> float:
        total = 0.0
        for array, share, weight in zip(arrays, shares, weights, strict=True):
            error = array.astype(np.float64) - _in_steps(coder.coding, array, step * share)
            total += float((weight * np.square(error)).sum())
        return total

    near = coder.least
    step = near and _longest(lambda step: loss(step) <= each * sum(sizes), near)
    return [step * share for share in shares]


def _in_steps(coding: CodingId, array: Float32, step: float) -> Float32:
    """Values that a reader gets of an array in this step, or in the shortest one long enough."""
    return decode_values(coding, encode_values(coding, array, step), *array.shape)


def _longest(good: Callable[[float], bool], near: float) -> float:
    """The longest good step, to a part in a thousand; the shortest of all if none is."""
    low, high = -SPAN, SPAN
    for _ in range(PROBES):
        middle = (low + high) / 2
        low, high = (middle, high) if good(near * 2.0**middle) else (low, middle)
    return near * 2.0**low
