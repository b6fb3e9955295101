"""Our policy: the most expected viewed quality over the next seconds.

It considers several whole orders in which the rest of the file could come, adds up for each the
quality of the predicted images while its blocks arrive, and requests the first item of the best.
The orders differ in how they weigh *more quality for the visible regions* against *coverage of the
regions ahead*. Within a level, blocks come by their marginal utility per byte (Smith's rule: on one
link, the order with the least weighted waiting). The policy starts again after every item, so an
order that the link or the camera spoils is left at once.
"""

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from gsynopsis.stream.catalog import FULL_DB, SHARED, Catalog, Key
from gsynopsis.stream.policy import (
    SAFETY,
    SEEN,
    Float64,
    State,
    affordable,
    estimate,
    fixed,
    missing,
)
from gsynopsis.stream.working_set import working_set

HORIZON = 4.0
"""Seconds ahead up to which moments count (ours). Where the camera will be later, and what blocks
add there, is known too badly: orders that wait for it lose more now than they win then."""
TAIL = 1.0
"""Seconds that the last of these moments lasts (ours)."""
NEAR_MOMENTS = 3
"""Moments of the middle window: now, in one and in two seconds."""
FORWARD = 4
"""Number of first items of the best order, each of which is tried at its front (ours)."""
SOONER = 0.01
"""An order with another item in front must promise this share more (ours): imagined quality is not
so exact that less would be worth it."""
MARGIN, GUESSED_MARGIN = 0.01, 0.02
"""Least gain of a sorted order over the best order by place in the file, as a share (ours).

Neighbours at one level look better than the sum of their parts. The second value is for files
without block utilities: then all blocks of a level weigh the same.
"""


_ratio, _place = attrgetter("ratio"), attrgetter("place")


def ours(state: State) -> Key | None:
    """Our policy, see the module; in a large file only the part `working_set` leaves is weighed."""
    margin = GUESSED_MARGIN if state.catalog.table is None else MARGIN
    part = working_set(within_horizon(state))
    return fixed(state) if part is None else _best(part, margin)


def _best(state: State, margin: float) -> Key | None:
    rate = SAFETY * estimate(state.samples)
    best, chosen = -1.0, list[Key]()

    def weigh(orders: Iterable[list[Key]], more: float = 0.0) -> None:
        nonlocal best, chosen
        for order in orders:
            value = viewed_quality(state, order, rate)
            if value > best + more:
                best, chosen = value, order

    # Of orders that are equal up to rounding the first wins.
    weigh(plain_orders(state), 1e-9)
    best *= 1 + margin
    weigh(sorted_orders(state))
    best *= 1 + SOONER
    weigh(promote(state, chosen))
    return chosen[0] if chosen else None


def within_horizon(state: State) -> State:
    """The state with only those moments that count, the present always."""
    count = max(1, int((state.moments <= HORIZON).sum()))
    return replace(state, shares=state.shares[:count], moments=state.moments[:count])


def plain_orders(state: State) -> Iterator[list[Key]]:
    """Orders in which blocks of a level come as they lie in the file; none is empty.

    First the whole file; then the regions visible now, or at any moment ahead: level after level up
    to each level, or straight to it, and all other blocks afterwards.
    """
    catalog = state.catalog
    choices = [list[Key]()]
    for share in (state.shares[0], state.shares.mean(axis=0)):
        covered = zip(catalog.items, catalog.covered(share).tolist(), strict=True)
        # Hardly visible blocks are left to the end: each would delay the visible ones.
        seen = [key for key, part in covered if part > SEEN and key not in state.known]
        for level in range(len(catalog.errors)):
            below = [key for key in seen if key.level <= level]
            choices += [below, [key for key in below if key.level == level]]
    yield from _whole(state, choices)


def sorted_orders(state: State) -> Iterator[list[Key]]:
    """Orders in which blocks come by marginal utility per byte; none is empty.

    By the views now, within two seconds, and over all moments ahead.
    """
    windows = (state.shares[:1], state.shares[:NEAR_MOMENTS], state.shares)
    yield from _whole(state, (ranked(state, shares) for shares in windows))


def promote(state: State, order: Sequence[Key]) -> Iterator[list[Key]]:
    """The same order with another of its first items in front, if what that needs is there.

    Ranked orders do not know when a block will be seen: one that is of use sooner may have to go
    before one that is of more use.
    """
    for place, key in enumerate(order[:FORWARD]):
        if place and not set(state.catalog.items[key].needs) & set(order[:place]):
            yield [key, *order[:place], *order[place + 1 :]]


def _whole(state: State, choices: Iterable[Iterable[Key]]) -> Iterator[list[Key]]:
    """For each choice: its missing items, then all others, needs first, within the device's limit.

    No order comes twice.
    """
    tried: set[tuple[Key, ...]] = set()
    everything = missing(state, state.catalog.items)
    for goals in dict.fromkeys(map(tuple, choices)):
        first = dict.fromkeys(missing(state, goals))
        order = drawable(state, [*first, *(key for key in everything if key not in first)])
        if order and tuple(order) not in tried:
            tried.add(tuple(order))
            yield order


def ranked(state: State, shares: Float64) -> list[Key]:
    """All blocks by marginal utility per byte, with lookahead to finer levels.

    The shared part of a level precedes all its blocks and has no utility itself. So a level is
    opened when its shared part together with the best of its blocks has a higher utility per byte
    than the rest of the open levels.

    Args:
        state: Where we are.
        shares: Rows of `State.shares` that count, [T', R].
    """
    own = block_jobs(state, shares)
    catalog, known, order = state.catalog, set(state.known), list[Key]()
    last = len(catalog.errors) - 1
    level = max((key.level for key in known if key.block == SHARED), default=0)
    composites = {up: composite_jobs(catalog, own, up) for up in range(level, last + 1)}
    while level <= last:
        # A finer level may be worth opening before the rest of this one is there.
        further = [
            _lookahead(catalog, composites[up], known, level, up)
            for up in range(level + 1, last + 1)
        ]
        best = max(further, key=lambda choice: choice.ratio, default=_Choice(-1.0, []))
        fresh = [
            key
            for job in jobs(catalog, composites[level], known)
            if job.ratio >= best.ratio
            for key in job.keys
        ]
        # All that is left of the open levels is worth less than a further level: open that one.
        if not fresh:
            fresh = best.keys
            level = level + 1 + further.index(best) if further else last + 1
        order += fresh
        known.update(fresh)
    return order


class Job(NamedTuple):
    """Blocks that come together: a block, and finer ones that raise its utility per byte.

    Attributes:
        ratio: Marginal utility per byte.
        place: Number of the first block in the file.
        value: Marginal utility: error that they remove from the images, relative to their error.
        size: Bytes.
        keys: The blocks, parents before children.
    """

    ratio: float
    place: int
    value: float
    size: int
    keys: list[Key]


def job_of(place: int, value: float, size: int, keys: list[Key]) -> Job:
    """A job with its ratio."""
    return Job(value / max(1, size), place, value, size, keys)


def block_jobs(state: State, shares: Float64) -> dict[Key, Job]:
    """Each missing block as a job of its own, in the order of the file.

    Its value is the error that it removes from the images if its parent is there.

    Args:
        state: Where we are.
        shares: Rows of `State.shares` that count, [T', R].
    """
    # What counts is decibels: the same error taken off a bad image is worth less.
    share = (shares / np.maximum(shares @ state.errors, 1e-12)[:, None]).mean(axis=0)
    catalog = state.catalog
    values = catalog.lowered(share).tolist()
    return {
        key: job_of(row, values[row], item.size, [key])
        for row, (key, item) in enumerate(catalog.items.items())
        if key in catalog.parents and key not in state.known
    }


class _Choice(NamedTuple):
    """Some items in an order that can be used, and their utility per byte."""

    ratio: float
    keys: list[Key]


Composites = dict[Key, list[Job]]
"""For each missing block up to some level, the jobs of it and of its descendants: its own first."""


def _lookahead(
    catalog: Catalog, composites: Composites, known: set[Key], level: int, up: int
) -> _Choice:
    """The best to ask for next if the levels after `level`, up to `up`, are opened for it."""
    shared = [Key(k, SHARED) for k in range(level + 1, up + 1)]
    keys = [key for key in shared if key in catalog.items and key not in known]
    size, value = sum(catalog.items[key].size for key in keys), 0.0
    best = -1.0
    for job in jobs(catalog, composites, known):
        value, size = value + job.value, size + job.size
        ratio = value / max(1, size)
        # Jobs come by falling ratio: from here on each one lowers the mean.
        if ratio < best:
            break
        best = ratio
        keys += job.keys
    return _Choice(best, keys if best >= 0 else [])


def composite_jobs(catalog: Catalog, own: dict[Key, Job], up: int) -> Composites:
    """The jobs of missing blocks up to a level, parents before children.

    Horn's rule (1972) for jobs on one machine whose precedence is a forest: a job takes in the
    best of its descendants while that raises its ratio; then the order of ratios is the best.

    Args:
        catalog: What there is.
        own: Blocks as jobs of their own, in the order of the file; all others are there.
        up: The level.
    """
    composites: Composites = {}
    above: Composites = {}
    for key, job in reversed(own.items()):
        if key.level > up:
            continue
        waiting = above.pop(key, [])
        # Blocks come finest first here, so the composites of a block's children are complete.
        waiting.sort(key=_ratio, reverse=True)
        while waiting and waiting[0].ratio > job.ratio:
            top = waiting.pop(0)
            job = job_of(job.place, job.value + top.value, job.size + top.size, job.keys + top.keys)
        # What was not taken in comes later than this job, and is worth less, so it may be free.
        composites[key] = [job, *waiting]
        above.setdefault(catalog.parents[key], []).extend(composites[key])
    return composites


def jobs(catalog: Catalog, composites: Composites, known: Container[Key]) -> list[Job]:
    """All jobs of missing blocks, best utility per byte first, parents before children.

    Args:
        catalog: What there is.
        composites: Jobs by block.
        known: Blocks that are there by now, none without its parent.
    """
    found: list[Job] = []
    for key, group in composites.items():
        parent = catalog.parents[key]
        if key not in known and (parent in known or parent not in composites):
            found += group
    # Equal ratios keep the order of the file.
    found.sort(key=_place)
    found.sort(key=_ratio, reverse=True)
    return found


def drawable(state: State, order: Sequence[Key]) -> list[Key]:
    """The order as far as the device can render it, item by item."""
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


def viewed_quality(state: State, order: Sequence[Key], rate: float) -> float:
    """Decibel-seconds of the images ahead while an order arrives at a constant rate.

    Each moment lasts until the next one, the last one for `TAIL`.

    Args:
        state: Where we are.
        order: Items, needs before what needs them.
        rate: Bytes per second.
    """
    catalog, end = state.catalog, float(state.moments[-1]) + TAIL
    rows = [catalog.rows[key] for key in order]
    arrivals = np.cumsum(catalog.sizes[rows]) / rate
    # What comes later is not seen.
    count = int(np.searchsorted(arrivals, end))
    # Errors of the leaves now, then those of each block alone; the least so far counts.
    leaves = np.vstack([state.errors, catalog.brings[rows[:count]]])
    quality = decibels(np.minimum.accumulate(leaves) @ state.shares.T)  # [count + 1, T]
    # The state before the first arrival counts too, and the last one has no end of its own.
    arrivals = np.concatenate([[0.0], arrivals[:count], [np.inf]])
    ends = np.append(state.moments[1:], end)
    starts = np.maximum(arrivals[:-1, None], state.moments)
    lasts = np.minimum(arrivals[1:, None], ends) - starts
    return float((quality * np.maximum(lasts, 0.0)).sum())


def decibels(errors: Float64) -> Float64:
    """PSNR against the full model, dB, from 0 to `FULL_DB`."""
    return np.clip(-10 * np.log10(np.maximum(errors, 1e-12)), 0.0, FULL_DB)
