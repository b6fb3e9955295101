from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.stream import lookahead as viewed
from gsynopsis.stream import working_set as narrow
from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.lookahead import ours, within_horizon
from gsynopsis.stream.policy import State, missing, slots_of
from gsynopsis.stream.working_set import MANY, WINDOW, working_set
from tests.stream.scenes import hand_made, large_states, state_of


def unnarrowed(state: State, patch: pytest.MonkeyPatch) -> Key | None:
    """What all that is left would say."""
    with patch.context() as changed:
        changed.setattr(narrow, "MANY", len(state.catalog.items))
        return ours(state)


def test_a_file_of_few_items_is_weighed_whole() -> None:
    catalog = hand_made({(1, 0): 10, (1, 1): 20}, (0.1, 0.01), 2, (5, 5))
    state = state_of(catalog, [[0.5, 0.5]])
    assert working_set(state) is state


def test_the_choice_among_what_is_seen_is_that_among_all(monkeypatch: pytest.MonkeyPatch) -> None:
    states = large_states(12)
    assert all(len(state.catalog.items) > MANY for state in states)
    same = [ours(state) == unnarrowed(state, monkeypatch) for state in states]
    assert sum(same) >= 11, "but for what is worth the same to a thousandth"


def test_what_is_left_out_keeps_its_share_and_error_of_the_images() -> None:
    for state in large_states(4, seen=300):
        part = working_set(within_horizon(state))
        assert part is not None
        assert part.catalog.leaves == WINDOW + 1
        assert np.allclose(part.shares.sum(axis=1), 1)
        whole = within_horizon(state)
        assert (part.shares @ part.errors).mean() == pytest.approx(
            (whole.shares @ whole.errors).mean(), rel=0.02
        )


def test_all_comes_once_with_its_needs_first() -> None:
    state = large_states(1)[0]
    everything = missing(state, state.catalog.items)
    left = everything[-150:]
    state = replace(state, held=state.held | set(everything[:-150]))
    order: list[Key] = []
    while (key := ours(state)) is not None:
        assert state.known.issuperset(state.catalog.items[key].needs)
        assert key not in state.held
        state = replace(state, held=state.held | {key})
        order.append(key)
    assert sorted(order) == sorted(left)


def test_a_small_device_is_asked_for_no_more_than_it_draws() -> None:
    state = replace(large_states(2)[1])
    room = 60_000
    state = replace(state, budget=slots_of(state, state.held) + room)
    while (key := ours(state)) is not None:
        state = replace(state, held=state.held | {key})
    assert 0 < state.budget - slots_of(state, state.held) < room


def test_before_the_base_is_there_it_comes_first() -> None:
    state = replace(large_states(1)[0], held=frozenset())
    assert ours(state) == Key(0, SHARED)
    assert viewed.fixed(state) == Key(0, SHARED)
