"""Our policy: the most expected viewed quality over the next seconds.

It imagines several whole orders in which the rest of the file could come, adds up for each the
quality of the pictures of the moments ahead while its blocks arrive, and asks for the first item
of the best. The orders differ in how they weigh *more quality for what is seen* against *coverage
of what will be seen*; within a level, blocks come by what they add to the pictures ahead for each
byte (Smith's rule: on one line, the order that costs the least waiting). It starts anew after
every item, so an order that the link or the camera spoils is left at once.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gsynopsis.stream.catalog import FULL_DB, Key
from gsynopsis.stream.policy import (
    SAFETY,
    SEEN,
    Float64,
    State,
    affordable,
    estimate,
    leaf_errors,
    levels_now,
    missing,
)

TAIL = 5.0
"""Seconds that the last moment ahead goes on counting (ours)."""

MARGIN = 0.02
"""A sorted order must promise this share more than the best in which blocks come as they lie in the
file (ours: neighbours at one level look better than the sum of their parts)."""


def ours(state: State) -> Key | None:
    """See the module."""
    rate = SAFETY * estimate(state.samples)
    table = table_of(state)
    best, chosen = -1.0, None
    for order in plain_orders(state):
        value = viewed_quality(state, order, rate, table)
        if value > best + 1e-9:
            best, chosen = value, order[0]
    best *= 1 + MARGIN
    for order in sorted_orders(state):
        value = viewed_quality(state, order, rate, table)
        if value > best:
            best, chosen = value, order[0]
    return chosen


def plain_orders(state: State) -> Iterator[list[Key]]:
    """Orders in which blocks of a level come as they lie in the file; none is empty.

    All of it; then for what is seen now, and for what is seen at any moment ahead: level after
    level up to each level, or straight to it, and all else afterwards.
    """
    items = state.catalog.items
    choices: list[Iterable[Key]] = [items]
    for share in (state.shares[0], state.shares.mean(axis=0)):
        seen = [key for key, item in items.items() if share[item.region].sum() > SEEN]
        for level in range(len(state.catalog.errors)):
            below = [key for key in seen if key.level <= level]
            choices += [[*below, *items], [*(k for k in seen if k.level == level), *items]]
    yield from _whole(state, choices)


def sorted_orders(state: State) -> Iterator[list[Key]]:
    """Orders in which blocks of a level come by what they add for each byte; none is empty.

    For what is seen now, and over all moments ahead: level after level, region after region to the
    finest level, and levels by the gain for each byte of all that they lack.
    """
    choices: list[Iterable[Key]] = []
    for shares in (state.shares[:1], state.shares):
        value = gains(state, shares)
        keys = sorted(value, key=lambda key, value=value: -value[key])
        choices += [sorted(keys, key=lambda key: key.level), keys, by_bundle(state, value, keys)]
    yield from _whole(state, choices)


def _whole(state: State, choices: Iterable[Iterable[Key]]) -> Iterator[list[Key]]:
    """What each choice lacks, needs first, as far as the device can draw it; none twice."""
    tried: set[tuple[Key, ...]] = set()
    for goals in choices:
        order = drawable(state, missing(state, goals))
        if order and tuple(order) not in tried:
            tried.add(tuple(order))
            yield order


def gains(state: State, shares: Float64) -> dict[Key, float]:
    """What each missing item takes off the error of the pictures, for each of its own bytes.

    Args:
        state: Where we are.
        shares: Rows of `State.shares` that count, [T', R].
    """
    errors = leaf_errors(state.catalog, levels_now(state))
    share = shares.mean(axis=0)
    known = state.held | state.asked
    found: dict[Key, float] = {}
    for key, item in state.catalog.items.items():
        if key in known:
            continue
        lower = np.maximum(errors[item.region] - state.catalog.errors[key.level], 0.0)
        found[key] = float(share[item.region] @ lower) / max(1, item.size)
    return found


def by_bundle(state: State, value: dict[Key, float], ranked: Sequence[Key]) -> list[Key]:
    """Levels by the gain per byte of all their seen blocks together with what these lack."""
    scores: dict[int, float] = {}
    for level in range(len(state.catalog.errors)):
        seen = [key for key in ranked if key.level == level and value[key] > 0]
        size = sum(state.catalog.items[key].size for key in missing(state, seen))
        gain = sum(value[key] * state.catalog.items[key].size for key in seen)
        scores[level] = gain / size if size else 0.0
    return sorted(ranked, key=lambda key: -scores[key.level])


def drawable(state: State, order: Sequence[Key]) -> list[Key]:
    """The order as far as the device can draw it, item by item."""
    if not state.budget:
        return list(order)
    kept: list[Key] = []
    for key in order:
        present = all(
            need in state.held or need in state.asked or need in kept
            for need in state.catalog.items[key].needs
        )
        if present and affordable(state, [*kept, key]):
            kept.append(key)
    return kept


@dataclass(frozen=True)
class Table:
    """What all orders of one state share.

    Attributes:
        errors: Of each leaf now, [R].
        rows: Number of each item.
        brings: Error to which an item brings each leaf, infinite where it does not, [I, R].
        sizes: Bytes of each item, [I].
    """

    errors: Float64
    rows: dict[Key, int]
    brings: Float64
    sizes: Float64


def table_of(state: State) -> Table:
    """The table of a state."""
    items = state.catalog.items
    brings = np.full((len(items), state.catalog.leaves), np.inf)
    for number, item in enumerate(items.values()):
        brings[number, item.region] = state.catalog.errors[item.key.level]
    return Table(
        errors=leaf_errors(state.catalog, levels_now(state)),
        rows={key: number for number, key in enumerate(items)},
        brings=brings,
        sizes=np.array([item.size for item in items.values()], np.float64),
    )


def viewed_quality(state: State, order: Sequence[Key], rate: float, table: Table) -> float:
    """Decibel-seconds of the pictures ahead while an order arrives at a constant rate.

    Each moment lasts until the next one, the last one for `TAIL`.

    Args:
        state: Where we are.
        order: Items, needs before what needs them.
        rate: Bytes per second.
        table: Of the state.
    """
    rows = [table.rows[key] for key in order]
    leaves = np.vstack([table.errors, table.brings[rows]])
    quality = decibels(np.minimum.accumulate(leaves) @ state.shares.T)  # [n + 1, T]
    arrivals = np.concatenate([[0.0], np.cumsum(table.sizes[rows]) / rate, [np.inf]])
    ends = np.append(state.moments[1:], state.moments[-1] + TAIL)
    starts = np.maximum(arrivals[:-1, None], state.moments)
    lasts = np.minimum(arrivals[1:, None], ends) - starts
    return float((quality * np.maximum(lasts, 0.0)).sum())


def decibels(errors: Float64) -> Float64:
    """PSNR against the full model, dB, from 0 to `FULL_DB`."""
    return np.clip(-10 * np.log10(np.maximum(errors, 1e-12)), 0.0, FULL_DB)
