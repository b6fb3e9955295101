"""Common rules for the next request: pure functions of a small state; ours is in `viewed.py`.

The rules of video players choose a bitrate for the next segment. Here nothing is thrown away, so
they choose up to which level to refine the visible regions, and request their missing blocks in the
order of the file, the visible parts first. Their constants are the defaults of dash.js and hls.js.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gsynopsis.stream.catalog import FULL_DB, SHARED, Catalog, Item, Key
from gsynopsis.stream.fetch import Sample

Float64 = NDArray[np.float64]
PolicyName: TypeAlias = Literal["fixed", "throughput", "bola", "mpc", "ours"]

SAFETY = 0.9
"""Share of the estimated throughput that is counted on (dash.js)."""
FAST_SECONDS, SLOW_SECONDS = 3.0, 8.0
"""Half-lives of the two averages; the smaller one counts (dash.js)."""
START_RATE = 62_500.0
"""Bytes per second before anything is measured: 500 kbit/s (hls.js)."""
SEGMENT = 4.0
"""Seconds in which a refinement should arrive (dash.js: a segment)."""
BUFFER = 18.0
"""Seconds of buffer that BOLA aims at (dash.js: buffer time at top quality of a stable player)."""
MPC_STEPS = 3
"""Choices that MPC looks ahead."""
MPC_SECONDS = 10.0
"""Seconds of the present view that MPC adds up (ours)."""
MPC_SAMPLES = 5
"""Measurements whose harmonic mean MPC counts on (Pensieve's robust MPC)."""
SEEN = 1e-3
"""Less of the image than this is not seen."""


@dataclass(frozen=True)
class State:
    """All that a policy may look at.

    Attributes:
        catalog: What there is.
        held: Items that are complete.
        asked: Items under way.
        samples: Measurements of throughput, oldest first.
        shares: Share of the image of each leaf at each moment ahead, [T, R]; row 0 is now.
        moments: Those moments, seconds from now, [T] ascending from 0.
        budget: Gaussian slots that the device can render; 0: no limit.
    """

    catalog: Catalog
    held: frozenset[Key]
    asked: frozenset[Key]
    samples: tuple[Sample, ...]
    shares: Float64
    moments: Float64
    budget: int = 0

    @cached_property
    def known(self) -> frozenset[Key]:
        """Items that are complete or under way."""
        return self.held | self.asked

    @cached_property
    def errors(self) -> Float64:
        """Error of each leaf when all that is under way is there, [R]; 1 where nothing is."""
        return leaf_errors(self.catalog.leaf_errors, levels_now(self))


Policy = Callable[[State], Key | None]
"""The next item to ask for; None to ask for nothing. Its needs are held or asked for already."""


def estimate(samples: Sequence[Sample]) -> float:
    """Throughput to count on, bytes per second, before the safety factor.

    The smaller of two averages that forget with different half-lives, each corrected for its
    start (dash.js, hls.js).
    """
    if not samples:
        return START_RATE
    averages: list[float] = []
    for half in (FAST_SECONDS, SLOW_SECONDS):
        value = weight = 0.0
        for sample in samples:
            keep = 0.5 ** (sample.seconds / half)
            value = keep * value + (1 - keep) * sample.amount / sample.seconds
            weight = keep * weight + 1 - keep
        averages.append(value / weight)
    return min(averages)


def missing(state: State, goals: Iterable[Key]) -> list[Key]:
    """Missing items for the goals that are not under way, each after those that it needs."""
    order: list[Key] = []
    known = set(state.known)

    def visit(key: Key) -> None:
        if key in known:
            return
        known.add(key)
        for need in state.catalog.items[key].needs:
            visit(need)
        order.append(key)

    for goal in goals:
        visit(goal)
    return order


def levels_now(state: State, *, asked: bool = True) -> NDArray[np.int64]:
    """The level of each leaf, [R]; -1 where there is nothing yet.

    Args:
        state: Present state.
        asked: Count items under way as held.
    """
    have = state.known if asked else state.held
    row, leaf, level, _ = state.catalog.pairs
    there = state.catalog.among(have)[row]
    levels = np.full(state.catalog.leaves, -1, np.int64)
    np.maximum.at(levels, leaf[there], level[there])
    return levels


def slots_of(state: State, keys: Iterable[Key]) -> int:
    """Gaussian slots that items bring."""
    return sum(state.catalog.items[key].slots for key in keys)


def affordable(state: State, keys: Sequence[Key]) -> bool:
    """True if the device can render these items besides those held or under way.

    The base is always affordable: without it there is no image.
    """
    if not state.budget or Key(0, SHARED) in keys:
        return True
    return slots_of(state, itertools.chain(state.held, state.asked, keys)) <= state.budget


def first_of(state: State, goals: Iterable[Key]) -> Key | None:
    """The first thing that the goals lack, goals that the device cannot render left out."""
    for goal in goals:
        if goal in state.known:
            continue
        lacks = missing(state, [goal])
        if lacks and affordable(state, lacks):
            return lacks[0]
    return None


def visible_items(state: State, level: int) -> list[Item]:
    """Items of a level that improve the visible regions, in the order of the file."""
    seen = state.catalog.covered(state.shares[0]) > SEEN
    items = zip(state.catalog.items.values(), seen, strict=True)
    return [item for item, is_seen in items if is_seen and item.key.level == level]


def bundles(state: State) -> dict[int, list[Key]]:
    """For each level above the present view's: all missing items of that level's view."""
    found: dict[int, list[Key]] = {}
    for level in range(len(state.catalog.errors)):
        lacks = missing(state, [item.key for item in visible_items(state, level)])
        if lacks and affordable(state, lacks):
            found[level] = lacks
    return found


def weight(state: State, keys: Iterable[Key]) -> int:
    """Bytes of items."""
    return sum(state.catalog.items[key].size for key in keys)


def fixed(state: State) -> Key | None:
    """The order of the file, whatever is seen and however fast the link is."""
    return first_of(state, state.catalog.items)


def throughput(state: State) -> Key | None:
    """The highest level of the visible regions that should arrive within a segment's time."""
    found = bundles(state)
    if not found:
        return fixed(state)
    can = SAFETY * estimate(state.samples) * SEGMENT
    fitting = [level for level, keys in found.items() if weight(state, keys) <= can]
    return found[max(fitting) if fitting else min(found)][0]


def bola(state: State) -> Key | None:
    """BOLA's score, utility and buffer against bytes, over the levels of the visible regions.

    The utility of a level is the logarithm of its bytes; the buffer, which video players count in
    seconds, is the share of the image that has a level at all, times `BUFFER`.
    """
    found = bundles(state)
    if not found:
        return fixed(state)
    sizes = {level: weight(state, keys) for level, keys in found.items()}
    least, most = min(sizes.values()), max(sizes.values())
    top = math.log(most / least) if most > least else 1.0
    # dash.js: gp = (u_max − 1) / (buffer / 10 + 1 − 1), V = 10 / gp, at least as small as these.
    gp = max((top - 1) / (BUFFER / 10), 0.1)
    held = state.shares[0][levels_now(state) >= 0].sum() * BUFFER / 2
    factor = 10.0 / gp

    def score(level: int) -> float:
        utility = math.log(sizes[level] / least)
        return (factor * (utility + gp) - held) / sizes[level]

    return found[max(found, key=score)][0]


def mpc(state: State) -> Key | None:
    """Model predictive control: the best of all short sequences of levels of the visible regions.

    Throughput is the harmonic mean of the last measurements, divided by one plus their largest
    deviation (robust MPC). A sequence is worth the quality of the present view over the next
    `MPC_SECONDS`.
    """
    found = bundles(state)
    if not found:
        return fixed(state)
    rate, end = robust_rate(state.samples), MPC_SECONDS
    best, chosen = -math.inf, min(found)
    present = _present_error(state, None)
    for count in range(1, MPC_STEPS + 1):
        for path in itertools.combinations(sorted(found), count):
            value, clock, error = 0.0, 0.0, present
            done: set[Key] = set()
            for level in path:
                fresh = [key for key in found[level] if key not in done]
                done |= set(fresh)
                spent = weight(state, fresh) / rate
                value += quality(error) * min(spent, max(0.0, end - clock))
                clock, error = clock + spent, _present_error(state, level)
            value += quality(error) * max(0.0, end - clock)
            if value > best + 1e-9:
                best, chosen = value, path[0]
    return found[chosen][0]


def robust_rate(samples: Sequence[Sample]) -> float:
    """Bytes per second that robust MPC counts on."""
    if not samples:
        return START_RATE
    rates = [sample.amount / sample.seconds for sample in samples[-MPC_SAMPLES:]]
    mean = len(rates) / sum(1 / rate for rate in rates)
    return mean / (1 + max(abs(rate - mean) / rate for rate in rates))


def quality(error: float) -> float:
    """An image's PSNR against the full model, dB, from 0 to `FULL_DB`."""
    return float(np.clip(-10 * math.log10(max(error, 1e-12)), 0.0, FULL_DB))


def _present_error(state: State, level: int | None) -> float:
    """Error of the present view, with visible regions refined to `level` if it is given."""
    levels = levels_now(state)
    now = state.shares[0]
    if level is not None:
        levels = np.where(now > 0, np.maximum(levels, level), levels)
    return float(now @ np.append(state.catalog.errors, 1.0)[levels])


def leaf_errors(table: Float64, levels: NDArray[np.int64]) -> Float64:
    """Error of each leaf at its level, [R]; 1 where there is nothing.

    Args:
        table: Errors of leaves by level, [levels, R].
        levels: Of each leaf, -1 where there is nothing, [R].
    """
    rows = np.vstack([table, np.ones((1, table.shape[1]))])
    return rows[levels, np.arange(len(levels))]
