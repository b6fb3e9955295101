"""Our policy: the most expected viewed quality over the next seconds.

It imagines several whole orders in which the rest of the file could come, adds up for each the
quality of the pictures of the moments ahead while its blocks arrive, and asks for the first item
of the best. The orders differ in how they weigh *more quality for what is seen* against *coverage
of what will be seen*; within a level, blocks come by what they add to the pictures ahead for each
byte (Smith's rule: on one line, the order that costs the least waiting). It starts anew after
every item, so an order that the link or the camera spoils is left at once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.stream.catalog import FULL_DB, SHARED, Key
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

HORIZON = 4.0
"""Seconds ahead up to which moments count (ours). Where the camera will be later, and what blocks
add there, is known too badly: orders that wait for it lose more now than they gain then."""
TAIL = 1.0
"""Seconds that the last of these moments lasts (ours)."""
NEAR_MOMENTS = 3
"""Moments of the middle window: now, in one and in two seconds."""
FORWARD = 4
"""So many of the first items of the best order are tried in front of it (ours)."""
SOONER = 0.01
"""An order with another item in front must promise this share more (ours): imagined quality is not
so exact that less would be worth it."""
MARGIN = 0.02
"""A sorted order must promise this share more than the best in which blocks come as they lie in the
file, where the file does not say what its blocks add (ours: then all of a level count alike, and
neighbours at one level look better than the sum of their parts)."""


def ours(state: State) -> Key | None:
    """See the module."""
    state = foreseen(state)
    rate = SAFETY * estimate(state.samples)
    table = table_of(state)
    best, chosen = -1.0, list[Key]()

    def weigh(orders: Iterable[list[Key]], more: float = 0.0) -> None:
        nonlocal best, chosen
        for order in orders:
            value = viewed_quality(state, order, rate, table)
            if value > best + more:
                best, chosen = value, order

    weigh(plain_orders(state), 1e-9)
    if state.catalog.table is None:
        best *= 1 + MARGIN
    weigh(sorted_orders(state))
    best *= 1 + SOONER
    weigh(brought_forward(state, chosen))
    return chosen[0] if chosen else None


def foreseen(state: State) -> State:
    """The state with only those moments that count, the present always."""
    count = max(1, int((state.moments <= HORIZON).sum()))
    return replace(state, shares=state.shares[:count], moments=state.moments[:count])


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
    """Orders in which blocks come by what they add for each byte; none is empty.

    For what is seen now, within two seconds, and over all moments ahead.
    """
    windows = (state.shares[:1], state.shares[:NEAR_MOMENTS], state.shares)
    items = state.catalog.items
    yield from _whole(state, ([*ranked(state, shares), *items] for shares in windows))


def brought_forward(state: State, order: Sequence[Key]) -> Iterator[list[Key]]:
    """The same order with another of its first items in front, if what that needs is there.

    Ranked orders do not know when a block will be seen: one that is of use sooner may have to go
    before one that is of more use.
    """
    for place, key in enumerate(order[:FORWARD]):
        if place and not set(state.catalog.items[key].needs) & set(order[:place]):
            yield [key, *order[:place], *order[place + 1 :]]


def _whole(state: State, choices: Iterable[Iterable[Key]]) -> Iterator[list[Key]]:
    """What each choice lacks, needs first, as far as the device can draw it; none twice."""
    tried: set[tuple[Key, ...]] = set()
    for goals in choices:
        order = drawable(state, missing(state, goals))
        if order and tuple(order) not in tried:
            tried.add(tuple(order))
            yield order


def ranked(state: State, shares: Float64) -> list[Key]:
    """All blocks, those first that take most off the error of the pictures for their bytes.

    What blocks of a level share is paid for by all blocks that come because of it: a level is
    opened when that, together with the best of its blocks, is worth more than what is open.

    Args:
        state: Where we are.
        shares: Rows of `State.shares` that count, [T', R].
    """
    value = values(state, shares)
    known, order = set(state.held | state.asked), list[Key]()
    last = len(state.catalog.errors) - 1
    level = max((key.level for key in known if key.block == SHARED), default=0)
    while level <= last:
        further = [_opened(state, value, known, level, up) for up in range(level + 1, last + 1)]
        best = max(further, key=lambda choice: choice.ratio, default=_Choice(-1.0, []))
        fresh = [
            key
            for job in jobs(state, value, known, level)
            if job.ratio >= best.ratio
            for key in job.keys
        ]
        if not fresh:
            fresh = best.keys
            level = level + 1 + further.index(best) if further else last + 1
        order += fresh
        known.update(fresh)
    return order


def values(state: State, shares: Float64) -> dict[Key, float]:
    """What each block takes off the pictures' errors, relative to these, when its parent is there.

    Args:
        state: Where we are.
        shares: Rows of `State.shares` that count, [T', R].
    """
    table = state.catalog.leaf_errors
    errors = leaf_errors(table, levels_now(state))
    # What counts is decibels: a bad picture gains less from the same error taken away.
    share = (shares / np.maximum(shares @ errors, 1e-12)[:, None]).mean(axis=0)
    return {
        key: float(share[item.region] @ _lower(table, key.level, item.region))
        for key, item in state.catalog.items.items()
        if key.level and key.block != SHARED
    }


def _lower(table: Float64, level: int, region: NDArray[np.int64]) -> Float64:
    return np.maximum(table[level - 1, region] - table[level, region], 0.0)


class _Choice(NamedTuple):
    """Some items in an order that can be used, and their value for each byte."""

    ratio: float
    keys: list[Key]


def _opened(
    state: State, value: Mapping[Key, float], known: set[Key], level: int, up: int
) -> _Choice:
    """The best to ask for next if the levels after `level`, up to `up`, are opened for it."""
    items = state.catalog.items
    doors = [Key(k, SHARED) for k in range(level + 1, up + 1)]
    keys = [key for key in doors if key in items and key not in known]
    size, gained = sum(items[key].size for key in keys), 0.0
    best = _Choice(-1.0, [])
    for job in jobs(state, value, known, up):
        gained, size = gained + job.value, size + job.size
        keys = [*keys, *job.keys]
        ratio = gained / max(1, size)
        if ratio < best.ratio:
            break
        best = _Choice(ratio, keys)
    return best


class Job(NamedTuple):
    """Blocks that come together: a block, and those on top of it that make it worth its bytes."""

    value: float
    size: int
    keys: list[Key]

    @property
    def ratio(self) -> float:
        """Value for each byte."""
        return self.value / max(1, self.size)


def jobs(state: State, value: Mapping[Key, float], known: set[Key], up: int) -> list[Job]:
    """Missing blocks up to a level, best value for each byte first, parents before children.

    Horn's rule (1972) for jobs on one machine whose precedence is a forest: a job takes in the
    best of those on top of it while that raises its ratio; then the order of ratios is the best.
    """
    items = state.catalog.items
    place = {key: number for number, key in enumerate(items)}
    above: dict[Key, list[Job]] = {}
    roots: list[Job] = []
    for key in reversed(place):
        if key.level > up or key not in value or key in known:
            continue
        job = Job(value[key], items[key].size, [key])
        waiting = sorted(above.pop(key, []), key=lambda j: j.ratio, reverse=True)
        while waiting and waiting[0].ratio > job.ratio:
            top = waiting.pop(0)
            job = Job(job.value + top.value, job.size + top.size, [*job.keys, *top.keys])
        parent = next(need for need in items[key].needs if need.level < key.level)
        there = parent in known or parent not in value
        target = roots if there else above.setdefault(parent, [])
        target += [job]
        # What was not taken in comes later than this job, and is worth less, so it may be free.
        target += waiting
    # Equal ratios keep the order of the file.
    return sorted(roots, key=lambda j: (-j.ratio, place[j.keys[0]]))


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
    items, table = state.catalog.items, state.catalog.leaf_errors
    brings = np.full((len(items), state.catalog.leaves), np.inf)
    for number, item in enumerate(items.values()):
        brings[number, item.region] = table[item.key.level, item.region]
    return Table(
        errors=leaf_errors(table, levels_now(state)),
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
