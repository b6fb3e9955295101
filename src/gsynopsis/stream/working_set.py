"""Working set of the policy in a large file: blocks of regions that fill most of the images ahead.

Our policy weighs whole orders of all that is left, which grows with the square of a scene. Its next
request does not need that: it is among the blocks of the leaves that fill most of the images and
are incomplete.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsynopsis.stream.catalog import SHARED, Catalog, Item, Key
from gsynopsis.stream.policy import State

MANY = 1024
"""Number of items up to which all are weighed (ours); no file of a room has more."""
WINDOW = 192
"""Leaves whose items are weighed in larger files (ours): some 500 blocks."""


def working_set(state: State) -> State | None:
    """The state of the leaves that matter most; the state itself where there are not `MANY` items.

    The rest is merged into one leaf, which nothing improves. None if no known block is missing.
    """
    catalog = state.catalog
    if len(catalog.items) <= MANY:
        return state
    row, leaf, _, _ = catalog.pairs
    lacking = np.zeros(catalog.leaves, np.bool_)
    lacking[leaf[~catalog.among(state.known)[row]]] = True
    if not lacking.any():
        return None
    worth = np.where(lacking, state.shares.max(axis=0), -1.0)
    count = min(WINDOW, int(lacking.sum()))
    leaves = np.sort(np.argsort(-worth, kind="stable")[:count])
    own = _part(catalog, leaves, state)
    rest = 1.0 - state.shares[:, leaves].sum(axis=1, keepdims=True)
    outside = sum(catalog.items[key].slots for key in state.known if key not in own.items)
    return replace(
        state,
        catalog=own,
        held=state.held & own.items.keys(),
        asked=state.asked & own.items.keys(),
        shares=np.hstack([state.shares[:, leaves], np.maximum(rest, 0.0)]),
        budget=max(1, state.budget - outside) if state.budget else 0,
    )


def _part(catalog: Catalog, leaves: np.ndarray, state: State) -> Catalog:
    """Items of some leaves, and their shared parts; the last leaf stands for all others."""
    place = np.full(catalog.leaves, -1)
    place[leaves] = np.arange(len(leaves))
    row, leaf, _, _ = catalog.pairs
    inside = place[leaf] >= 0
    rows, first = np.unique(row[inside], return_index=True)
    regions = np.split(place[leaf[inside]], first[1:])
    items = dict(_items(catalog, dict(zip(rows.tolist(), regions, strict=True)), len(leaves)))
    share = state.shares.mean(axis=0)
    share[leaves] = 0
    error = float(share @ state.errors / max(float(share.sum()), 1e-12))
    table = np.hstack([catalog.leaf_errors[:, leaves], np.full((len(catalog.errors), 1), error)])
    low, high = (np.vstack([box[leaves], box[:1]]) for box in (catalog.low, catalog.high))
    return Catalog(items, catalog.errors, low, high, table)


def _items(
    catalog: Catalog, regions: dict[int, np.ndarray], others: int
) -> Iterator[tuple[Key, Item]]:
    for row, (key, item) in enumerate(catalog.items.items()):
        if key == (0, SHARED):
            yield key, replace(item, region=np.arange(others + 1))
        elif row in regions:
            yield key, replace(item, region=regions[row])
        elif key.block == SHARED:
            yield key, item
