"""Published policies, to compare with: L3GS's scheduler, and MPC with a predicted view.

Written from the published descriptions, on the same state as all policies: same estimate of the
line, same prediction of the camera, same items. So only the rule differs.
"""

import itertools
import math
from collections.abc import Iterable, Iterator

import numpy as np

from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.lookahead import viewed_quality
from gsynopsis.stream.policy import (
    SAFETY,
    SEEN,
    Float64,
    State,
    affordable,
    estimate,
    first_of,
    fixed,
    missing,
    robust_rate,
    weight,
)

SLOT = 1.0
"""Seconds for which L3GS plans at a time."""
UNITS = 200
"""Parts into which a slot's bytes are divided for the knapsack."""
BUNDLES = 2
"""Choices that the predicting MPC looks ahead."""


def l3gs(state: State) -> Key | None:
    """L3GS's utility scheduler (arXiv 2504.05517): a knapsack of layers for each time slot.

    Objects are the blocks of the first level that has any; their layers are the levels of the
    blocks within them. A layer's value is the error that it removes from the predicted images. For
    each object the number of layers is chosen that together have the largest value and arrive
    within a slot; base layers come first. Parts that a level's blocks share are paid for once, by
    the first object that needs the level.
    """
    if Key(0, SHARED) not in state.known:
        return fixed(state)
    objects = _objects(state)
    best, chosen = 0.0, list[Key]()
    room = SAFETY * estimate(state.samples) * SLOT
    for level in range(len(state.catalog.errors)):
        parts = (key for key in state.catalog.items if key.block == SHARED and key.level <= level)
        shared = missing(state, parts)
        left = room - weight(state, shared)
        if left <= 0:
            break
        value, keys = _knapsack(state, objects, level, left)
        if value > best:
            best, chosen = value, [*shared, *keys]
    chosen.sort(key=lambda key: (key.level, state.catalog.rows[key]))
    chosen = [key for key in missing(state, chosen) if affordable(state, [key])]
    return chosen[0] if chosen else _best_ratio(state, objects)


def _objects(state: State) -> list[list[tuple[float, list[Key]]]]:
    """Missing layers of each object: value and blocks, level by level."""
    catalog = state.catalog
    values = catalog.lowered(state.shares.mean(axis=0))
    found: dict[Key, list[tuple[float, list[Key]]]] = {}
    levels = len(catalog.errors)
    roots: dict[Key, Key] = {}
    for key in catalog.items:
        if key not in catalog.parents:
            continue
        roots[key] = root = roots.get(catalog.parents[key], key)
        layers = found.setdefault(root, [(0.0, list[Key]()) for _ in range(levels)])
        if key not in state.known:
            value, keys = layers[key.level]
            layers[key.level] = value + float(values[catalog.rows[key]]), [*keys, key]
    return [layers for layers in found.values() if any(keys for _, keys in layers)]


def _knapsack(
    state: State, objects: list[list[tuple[float, list[Key]]]], level: int, room: float
) -> tuple[float, list[Key]]:
    """The most that layers up to a level are worth that fit into some bytes, and their blocks."""
    unit = room / UNITS
    worth, picked = np.zeros(UNITS + 1), list[list[int]]()
    tables: list[list[tuple[int, float]]] = []
    for layers in objects:
        options, value, size = [(0, 0.0)], 0.0, 0
        for gain, keys in layers[: level + 1]:
            value, size = value + gain, size + weight(state, keys)
            options.append((math.ceil(size / unit), value))
        rows = np.stack([_after(worth, *option) for option in options])
        picked.append(rows.argmax(axis=0).tolist())
        tables.append(options)
        worth = rows.max(axis=0)
    left, keys = UNITS, list[Key]()
    for layers, options, choice in zip(objects[::-1], tables[::-1], picked[::-1], strict=True):
        option = choice[left]
        left -= options[option][0]
        keys += [key for _, own in layers[:option] for key in own]
    return float(worth[UNITS]), keys


def _after(worth: Float64, size: int, value: float) -> Float64:
    """Value of each number of units of room with an option taken, -∞ if it does not fit."""
    if size > UNITS:
        return np.full(UNITS + 1, -np.inf)
    found = np.full(UNITS + 1, -np.inf)
    found[size:] = worth[: UNITS + 1 - size] + value
    return found


def _best_ratio(state: State, objects: list[list[tuple[float, list[Key]]]]) -> Key | None:
    """The layer of the largest value per byte, if none fits into a slot; else the file's order."""
    best, chosen = 0.0, None
    for layers in objects:
        for value, keys in layers:
            lacks = missing(state, keys)
            if not lacks or not affordable(state, lacks):
                continue
            ratio = value / max(1, weight(state, lacks))
            if ratio > best:
                best, chosen = ratio, lacks[0]
    return chosen or first_of(state, state.catalog.items)


def mpc_viewport(state: State) -> Key | None:
    """MPC over levels, as `policy.mpc`, of the predicted views instead of the present one.

    A bundle is the visible part now, at the next moment, at the last predicted moment, or at any of
    them, up to a level. Among all sequences of up to `BUNDLES` bundles, the one is begun whose
    images ahead are best while it arrives, at the rate of robust MPC. Blocks of a bundle come in
    the order of the file.
    """
    rate, best, chosen = robust_rate(state.samples), -math.inf, list[Key]()
    for order in _sequences(state):
        value = viewed_quality(state, order, rate)
        if value > best + 1e-9:
            best, chosen = value, order
    return chosen[0] if chosen else fixed(state)


def _sequences(state: State) -> Iterator[list[Key]]:
    """Missing items of each sequence of bundles, needs first; none is empty, none comes twice."""
    bundles = list(dict.fromkeys(map(tuple, _bundles(state))))
    tried: set[tuple[Key, ...]] = set()
    for count in range(1, BUNDLES + 1):
        for chosen in itertools.permutations(bundles, count):
            order = tuple(missing(state, itertools.chain(*chosen)))
            if order and order not in tried and affordable(state, order):
                tried.add(order)
                yield list(order)


def _bundles(state: State) -> Iterable[list[Key]]:
    catalog = state.catalog
    rows = state.shares
    for share in (rows[0], rows[min(1, len(rows) - 1)], rows[-1], rows.mean(axis=0)):
        covered = zip(catalog.items, catalog.covered(share).tolist(), strict=True)
        seen = [key for key, part in covered if part > SEEN and key not in state.known]
        for level in range(len(catalog.errors)):
            yield [key for key in seen if key.level <= level]
