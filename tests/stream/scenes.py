"""A small file with several blocks per level, and catalogs made by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from gsynopsis.container import Assembler
from gsynopsis.container.writer import encode_with_account
from gsynopsis.stream.catalog import SHARED, Catalog, Item, Key
from gsynopsis.stream.fetch import Sample
from gsynopsis.stream.policy import State, missing
from gsynopsis.stream.views import LEAK
from tests.level_sets import PLAIN_SPLATS, Shape, make_level_set

SHAPE = Shape(anchors=(60, 300, 1500, 4000), slots=4)


FREE = Shape(SHAPE.anchors, 4, (0, 0, 0, 0), 0, 0, 0, residual=3, common=True)
"""Nothing that blocks of a level share but networks, of which matrices are inherited."""
PLAIN = replace(PLAIN_SPLATS, anchors=SHAPE.anchors)
"""Splats without a codebook: blocks of a level share nothing."""


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
