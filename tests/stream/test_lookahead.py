"""Our policy against all orders of small files, and against its own definition."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.lookahead import composite_jobs, job_of, jobs, ours, plain_orders, ranked
from gsynopsis.stream.policy import SEEN, missing
from tests.stream.scenes import (
    BASE,
    CASES,
    ERRORS,
    EVEN,
    USUAL,
    brute_force,
    hand_made,
    played,
    state_of,
    watched,
)


@pytest.mark.parametrize("name", CASES)
def test_the_first_choice_of_ours_begins_an_order_that_is_as_good_as_any(name: str) -> None:
    shares, sizes, shared = CASES[name]
    catalog = hand_made(sizes, ERRORS, 3, shared)
    # Nine items have too many orders: what is never seen, and a third region, are there already.
    seen = [leaf for leaf in range(3) if np.array(shares)[:, leaf].any()][:2]
    given = [Key(k, leaf) for k in (1, 2) for leaf in range(3) if leaf not in seen]
    state = state_of(catalog, shares, rate=1000 / 0.9, held=(BASE, Key(1, SHARED), *given))
    best, orders = brute_force(state, 1000.0)
    choice = ours(state)
    reached = max(value for value, order in orders if order[0] == choice)
    assert reached >= 0.99 * best
    if shares[0] == shares[-1]:
        mine = watched(state, played(state, ours), 1000.0)
        assert mine >= 0.98 * best
        others = max(watched(state, played(state, rule), 1000.0) for rule in USUAL)
        assert mine >= 0.998 * others


def test_what_will_be_seen_goes_before_more_of_what_is_seen() -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    turning = [[1.0, 0, 0], *[[0, 1.0, 0]] * 9]
    shared = (BASE, Key(1, SHARED))
    assert ours(state_of(catalog, turning, rate=500)) == Key(1, SHARED)
    assert ours(state_of(catalog, turning, rate=500, held=shared)) == Key(1, 1)
    assert ours(state_of(catalog, [[1.0, 0, 0]] * 9, rate=500, held=shared)) == Key(1, 0)
    seen = (*shared, Key(1, 0))
    assert ours(state_of(catalog, turning, rate=500, held=seen)) == Key(1, 1)


def test_plain_orders_are_what_is_seen_and_then_all_else_needs_first() -> None:
    """Against their definition: each goal and all items, visited one after the other."""
    catalog = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    shares = [[0.9, 0.1, 0], [0.5, 0, 0.5], [0.2, 0.8, 0]]
    everything = missing(state_of(catalog, shares, held=()), catalog.items)
    most = 0
    for count in range(len(everything)):
        state = state_of(catalog, shares, held=tuple(everything[:count]))
        wanted = [missing(state, catalog.items)]
        for share in (state.shares[0], state.shares.mean(axis=0)):
            seen = [k for k, item in catalog.items.items() if share[item.region].sum() > SEEN]
            for level in range(3):
                for goals in (
                    [key for key in seen if key.level <= level],
                    [key for key in seen if key.level == level],
                ):
                    wanted.append(missing(state, [*goals, *catalog.items]))
        once = [order for n, order in enumerate(wanted) if order not in wanted[:n]]
        assert list(plain_orders(state)) == once
        most = max(most, len(once))
    assert most > 2


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1), st.integers(1, 20)), min_size=6, max_size=6))
def test_jobs_come_in_the_best_order_that_parents_allow(pairs: list[tuple[float, int]]) -> None:
    """Horn's rule against all orders of two levels of three blocks: least weighted waiting."""
    sizes = {(1 + n // 3, n % 3): size for n, (_, size) in enumerate(pairs)}
    catalog = hand_made(sizes, ERRORS, 3, (500, 0, 0))
    value = {Key(1 + n // 3, n % 3): worth for n, (worth, _) in enumerate(pairs)}
    own = {
        key: job_of(catalog.rows[key], worth, catalog.items[key].size, [key])
        for key, worth in value.items()
    }

    def cost(order: Sequence[Key]) -> float:
        clock = total = 0.0
        for key in order:
            clock += sizes[key.level, key.block]
            total += clock * value[key]
        return total

    def allowed(order: Sequence[Key]) -> bool:
        return all(order.index(Key(1, n)) < order.index(Key(2, n)) for n in range(3))

    mine = [key for job in jobs(catalog, composite_jobs(catalog, own, 2), ()) for key in job.keys]
    assert allowed(mine)
    best = min(cost(order) for order in itertools.permutations(value) if allowed(order))
    assert cost(mine) <= best * (1 + 1e-9) + 1e-9


def test_ours_begins_with_the_block_that_adds_most_where_the_file_says_so() -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 0, 0))
    held = (BASE, Key(1, SHARED), Key(2, SHARED))
    for leaf in range(3):
        table = np.tile(np.array(ERRORS)[:, None], (1, 3))
        table[0, leaf] *= 5
        told = replace(catalog, table=table)
        assert ours(state_of(told, [[1 / 3] * 3] * 4, held=held)) == Key(1, leaf)


def test_a_dear_shared_part_is_paid_by_what_it_opens() -> None:
    shares = [[1 / 3] * 3] * 4
    for shared, opens in ((100, True), (100_000, False)):
        catalog = hand_made(EVEN, (1e-2, 9e-3, 1e-5), 3, (500, 0, shared))
        state = state_of(catalog, shares, held=(BASE, Key(1, SHARED), Key(1, 0)))
        assert (ranked(state, state.shares)[0] == Key(2, SHARED)) == opens
