"""A small file with several blocks per level, and catalogs made by hand."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from gsynopsis.container import Assembler
from gsynopsis.container.writer import encode_with_account
from gsynopsis.stream import policy
from gsynopsis.stream.catalog import FULL_DB, SHARED, Catalog, Item, Key
from gsynopsis.stream.fetch import Sample
from gsynopsis.stream.policy import State, missing
from gsynopsis.stream.views import LEAK
from tests.level_sets import PLAIN_SPLATS, Shape, make_level_set

SHAPE = Shape(anchors=(60, 300, 1500, 4000), slots=4)
FREE = Shape(SHAPE.anchors, 4, (0, 0, 0, 0), 0, 0, 0, residual=3, common=True)
"""Nothing that blocks of a level share but networks, of which matrices are inherited."""
PLAIN = replace(PLAIN_SPLATS, anchors=SHAPE.anchors)
"""Splats without a codebook: blocks of a level share nothing."""
USUAL = [policy.fixed, policy.throughput, policy.bola, policy.mpc]
BASE = Key(0, SHARED)
ERRORS = (1e-2, 1e-3, 1e-5)
EVEN = {(level, leaf): 1000 for level in (1, 2) for leaf in range(3)}
CASES = {
    # What is seen now, all the time: its blocks first, up to the finest level.
    "one region seen": ([[1, 0, 0]] * 4, EVEN, (500, 100, 100)),
    # The camera turns to another region at once: coverage of what will be seen goes first.
    "the camera turns away": ([[1, 0, 0], *[[0, 0, 1]] * 4], EVEN, (500, 100, 100)),
    "two regions, one small file": (
        [[0.5, 0.5, 0]] * 4,
        {**EVEN, (1, 1): 100, (2, 1): 100},
        (500, 100, 100),
    ),
    "dear shared part of the finest level": ([[0.4, 0.3, 0.3]] * 4, EVEN, (500, 100, 4000)),
    "cheap finest level": (
        [[0.4, 0.3, 0.3]] * 4,
        {k: 100 if k[0] == 2 else 1000 for k in EVEN},
        (500, 0, 0),
    ),
}


@cache
def small_file(block: int = 128, shape: Shape = SHAPE) -> bytes:
    data, _ = encode_with_account(make_level_set(np.random.default_rng(3), shape), block=block)
    return data


def assembler_of_small_file() -> Assembler:
    assembler = Assembler(small_file()[:16384], "small")
    assembler.add_level(small_file())
    return assembler


def hand_made(
    sizes: Mapping[tuple[int, int], int],
    errors: Sequence[float],
    leaves: int,
    shared: Sequence[int],
) -> Catalog:
    """A base, shared parts of the given sizes, and one block per level and leaf.

    Args:
        sizes: Bytes by level and leaf, from level 1 on.
        errors: Of each level.
        leaves: How many regions.
        shared: Bytes of the base, then of what the blocks of each level share.
    """
    items: dict[Key, Item] = {}
    start = 0

    def put(key: Key, size: int, needs: tuple[Key, ...], region: list[int]) -> None:
        nonlocal start
        items[key] = Item(key, start, start + size, needs, np.array(region, np.int64), size)
        start += size

    put(Key(0, SHARED), shared[0], (), list(range(leaves)))
    for level in range(1, len(errors)):
        put(Key(level, SHARED), shared[level], (Key(level - 1, SHARED),), [])
        for leaf in range(leaves):
            above = Key(level - 1, leaf if level > 1 else SHARED)
            put(Key(level, leaf), sizes[level, leaf], (above, Key(level, SHARED)), [leaf])
    corners = np.arange(3.0 * leaves).reshape(leaves, 3)
    return Catalog(items, np.array(errors), corners, corners + 1)


def state_of(
    catalog: Catalog,
    shares: Sequence[Sequence[float]],
    rate: float = 1000.0,
    held: Sequence[Key] = (Key(0, SHARED),),
    budget: int = 0,
) -> State:
    """A state with an exactly known throughput, bytes per second, and moments a second apart."""
    table = np.array(shares, np.float64)
    samples = (Sample(round(rate * 10), 10.0),)
    moments = np.arange(len(table), dtype=np.float64)
    return State(catalog, frozenset(held), frozenset(), samples, table, moments, budget)


def large_states(count: int, leaves: int = 400, seen: int = 60) -> list[State]:
    """States of a file of more items than are weighed at once, of which images show some leaves."""
    rng = np.random.default_rng(11)
    levels = (1, 2, 3)
    found: list[State] = []
    for number in range(count):
        sizes = {
            (k, leaf): int(rng.integers(2_000, 40_000)) for k in levels for leaf in range(leaves)
        }
        shared = rng.integers(100, 5_000, 4).tolist()
        catalog = hand_made(sizes, (0.1, 1e-2, 1e-3, 1e-5), leaves, shared)
        shares = np.full((5, leaves), LEAK / leaves)
        for moment, row in enumerate(shares):
            row[4 * moment : 4 * moment + seen] += (1 - LEAK) * rng.dirichlet(np.ones(seen))
        keys = list(catalog.items)
        there = [keys[i] for i in rng.permutation(len(keys))[: int(rng.integers(0, 700))]]
        held = missing(state_of(catalog, shares.tolist(), held=()), [keys[0], *there])
        budget = 8_000_000 if number % 2 else 0
        found.append(state_of(catalog, shares.tolist(), 10 ** rng.uniform(5, 6.5), held, budget))
    return found


def played(state: State, rule: policy.Policy) -> tuple[Key, ...]:
    """The order in which a policy asks for everything when nothing changes but what is held."""
    order: list[Key] = []
    held = set(state.held)
    while len(held) < len(state.catalog.items):
        now = State(state.catalog, frozenset(held), frozenset(), state.samples, state.shares,
                    state.moments)  # fmt: skip
        key = rule(now)
        assert key is not None
        assert key not in held
        assert held.issuperset(state.catalog.items[key].needs)
        held.add(key)
        order.append(key)
    return tuple(order)


def brute_force(state: State, rate: float) -> tuple[float, list[tuple[float, tuple[Key, ...]]]]:
    """The best decibel-seconds over all orders, and those of every order."""
    rest = [key for key in state.catalog.items if key not in state.held]
    values = [(watched(state, order, rate), order) for order in itertools.permutations(rest)]
    return max(value for value, _ in values), values


def watched(state: State, order: tuple[Key, ...], rate: float) -> float:
    """What a viewer gets of one order: an own account, in steps of a tenth of a second.

    Sizes and rates of the cases are such that everything arrives at a step's end.
    """
    arrivals, clock = dict.fromkeys(state.held, 0.0), 0.0
    for key in order:
        clock += state.catalog.items[key].size / rate
        arrivals[key] = clock
    usable: dict[Key, float] = {}
    for key in sorted(arrivals, key=lambda k: (k.level, k.block)):
        needs = state.catalog.items[key].needs
        usable[key] = max([arrivals[key], *(usable[need] for need in needs)])
    regions = {key: set(state.catalog.items[key].region.tolist()) for key in arrivals}
    value, end = 0.0, float(state.moments[-1]) + 1.0
    for step in range(round(end * 10)):
        now = (step + 0.5) / 10
        row = min(int(now), len(state.shares) - 1)
        error = 0.0
        there = [key for key, at in usable.items() if at <= now]
        for leaf, share in enumerate(state.shares[row]):
            levels = [key.level for key in there if leaf in regions[key]]
            error += share * (state.catalog.errors[max(levels)] if levels else 1.0)
        value += 0.1 * min(FULL_DB, max(0.0, -10 * math.log10(max(error, 1e-12))))
    return value
