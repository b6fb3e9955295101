"""Policies of others: L3GS's knapsack against all choices, MPC that looks ahead."""

import itertools

import numpy as np
import pytest

from gsynopsis.stream import policy
from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.policy import SAFETY
from research.policies import SLOT, l3gs, mpc_viewport
from tests.stream.scenes import hand_made, state_of

BASE = Key(0, SHARED)
ERRORS = (1e-2, 1e-3, 1e-5)
EVEN = {(level, leaf): 1000 for level in (1, 2) for leaf in range(3)}


def most_worth(state: policy.State, room: float) -> float:
    """Of all numbers of layers of each of three leaves, the most worth that fits."""
    catalog = state.catalog
    values = catalog.lowered(state.shares.mean(axis=0))
    best = 0.0
    for depth in itertools.product(range(3), repeat=3):
        keys = [Key(k, leaf) for leaf, top in enumerate(depth) for k in range(1, top + 1)]
        shared = [Key(k, SHARED) for k in range(1, max(depth) + 1)]
        fresh = [key for key in (*shared, *keys) if key not in state.known]
        if sum(catalog.items[key].size for key in fresh) <= room:
            worth = sum(float(values[catalog.rows[key]]) for key in fresh)
            best = max(best, worth)
    return best


@pytest.mark.parametrize("seed", range(8))
def test_layers_of_a_slot_are_worth_as_much_as_any(seed: int) -> None:
    chance = np.random.default_rng(seed)
    # Sizes are units of the knapsack, so that nothing is lost by its rounding.
    sizes = {key: int(chance.integers(1, 80)) * 10 for key in EVEN}
    shares = chance.dirichlet(np.ones(3), 4).tolist()
    catalog = hand_made(sizes, ERRORS, 3, (500, 20, 30))
    rate = 2000 / SAFETY / SLOT
    room, held, got = 2000.0, [BASE, Key(1, SHARED), Key(2, SHARED)], list[Key]()
    state = state_of(catalog, shares, rate=rate, held=held)
    wanted = most_worth(state, room)
    values = catalog.lowered(state.shares.mean(axis=0))
    worth = 0.0
    while room > 0:
        now = state_of(catalog, shares, rate=room / SAFETY / SLOT, held=[*held, *got])
        key = l3gs(now)
        if key is None or catalog.items[key].size > room:
            break
        room -= catalog.items[key].size
        worth += float(values[catalog.rows[key]])
        got.append(key)
    # Each choice begins a best set; what is left of the room is planned anew and stays as good, up
    # to sizes that are no whole units of the smaller room.
    assert worth >= 0.93 * wanted > 0


def test_a_level_that_is_not_worth_its_shared_part_is_not_opened() -> None:
    shares = [[0.4, 0.3, 0.3]] * 4
    room = 3000 / SAFETY / SLOT
    cheap = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    held = (BASE, Key(1, SHARED), Key(1, 0), Key(1, 1))
    assert l3gs(state_of(cheap, shares, rate=room, held=held)) == Key(1, 2)
    dear = hand_made(EVEN, ERRORS, 3, (500, 100, 2500))
    done = (*held, Key(1, 2))
    assert l3gs(state_of(cheap, shares, rate=room, held=done)) == Key(2, SHARED)
    # It does not fit into the slot with any of its blocks, and is asked for as all else is there.
    assert l3gs(state_of(dear, shares, rate=room, held=done)) == Key(2, SHARED)


def test_more_for_what_will_be_seen_most_comes_first() -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 0, 0))
    held = (BASE, Key(1, SHARED), Key(2, SHARED))
    turning = [[1.0, 0, 0], *[[0, 1.0, 0]] * 4]
    still = [[1.0, 0, 0]] * 5
    for rule in (l3gs, mpc_viewport):
        assert rule(state_of(catalog, still, rate=1200, held=held)) == Key(1, 0)
    assert l3gs(state_of(catalog, turning, rate=1200, held=held)) == Key(1, 1)
    # MPC counts seconds: on a line so slow the region that comes later is of more use.
    assert mpc_viewport(state_of(catalog, turning, rate=500, held=held)) == Key(1, 1)
    assert policy.mpc(state_of(catalog, turning, rate=500, held=held)) == Key(1, 0)


@pytest.mark.parametrize("rule", [l3gs, mpc_viewport])
def test_a_device_is_not_asked_for_more_than_it_can_draw(rule: policy.Policy) -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 0, 0))
    held = [BASE, Key(1, SHARED), Key(2, SHARED)]
    shares = [[0.4, 0.3, 0.3]] * 4
    slots = sum(catalog.items[key].slots for key in held)
    for _ in range(6):
        state = state_of(catalog, shares, rate=1e6, held=held, budget=slots + 2500)
        key = rule(state)
        if key is None:
            break
        held.append(key)
    assert sum(catalog.items[key].slots for key in held) == slots + 2000
