"""Layouts that are only sizes and qualities: separate files per level, and other methods' files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gsynopsis.stream.catalog import SHARED, Catalog, Item, Key
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.policy import Policy, State, estimate
from gsynopsis.stream.session import AHEAD, PIPE


@dataclass(frozen=True)
class Played:
    """Result of one play of sizes: time of each level, bytes received, and bytes wasted."""

    ready: Mapping[int, float]
    received: int
    wasted: int


def files_catalog(sizes: Mapping[int, int], errors: Sequence[float]) -> Catalog:
    """Separate files, each of the whole scene at its level; nothing of one helps another."""
    items: dict[Key, Item] = {}
    start = 0
    for level, size in sizes.items():
        key = Key(level, SHARED)
        items[key] = Item(key, start, start + size, (), np.zeros(1, np.int64))
        start += size
    corner = np.array([[-1.0, -1.0, -1.0]])
    return Catalog(items, np.array(errors), corner, -corner)


def play_files(fetcher: Fetcher, catalog: Catalog, policy: Policy, seconds: float) -> Played:
    """Download files as a policy wants them, until the finest is there or time is up.

    A file coarser than the present one is of no use and is not requested.
    """
    held: set[Key] = set()
    ready: dict[int, float] = {}
    finest = max(key.level for key in catalog.items)
    while finest not in ready and fetcher.transport.now() < seconds:
        asked = frozenset(key for key in fetcher.keys if isinstance(key, Key))
        under_way = sum(fetcher.left(key) for key in asked)
        if fetcher.free and under_way <= PIPE * estimate(fetcher.samples):
            best = max((key.level for key in held | asked), default=-1)
            useless = {key for key in catalog.items if key.level < best}
            state = State(
                catalog,
                frozenset(held | useless),
                asked,
                fetcher.samples,
                np.ones((len(AHEAD), 1)),
                np.array(AHEAD),
            )
            key = policy(state)
            if key is not None:
                fetcher.request(key, catalog.items[key].start, catalog.items[key].stop)
        for got in fetcher.wait(seconds):
            assert isinstance(got.key, Key)
            held.add(got.key)
            ready[got.key.level] = got.ended
    # Every file but the one that is shown in the end was downloaded for the time being.
    shown = max(ready, default=-1)
    wasted = sum(catalog.items[key].size for key in held if key.level != shown)
    return Played(ready, fetcher.received, wasted)
