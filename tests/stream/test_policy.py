import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsynopsis.stream import policy
from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.fetch import Sample
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.policy import estimate, missing, robust_rate
from research.policies import l3gs, mpc_viewport
from tests.stream.scenes import BASE, ERRORS, EVEN, USUAL, hand_made, played, state_of

POLICIES = [*USUAL, mpc_viewport, l3gs, ours]


@pytest.mark.parametrize("rule", POLICIES)
def test_every_policy_asks_for_everything_needs_first(rule: policy.Policy) -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    state = state_of(catalog, [[0.7, 0.3, 0]] * 3, held=())
    assert len(played(state, rule)) == len(catalog.items)
    assert played(state, rule)[0] == BASE


@pytest.mark.parametrize("rule", POLICIES)
def test_no_policy_goes_over_the_budget_of_the_device(rule: policy.Policy) -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 0, 0))
    held = {BASE}
    while True:
        key = rule(state_of(catalog, [[0.5, 0.5, 0]] * 3, held=tuple(held), budget=2600))
        if key is None:
            break
        held.add(key)
    assert sum(catalog.items[key].slots for key in held) in {2500, 1500}


@pytest.mark.parametrize("rule", POLICIES)
def test_with_all_in_hand_nothing_is_asked_for(rule: policy.Policy) -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 0, 0))
    assert rule(state_of(catalog, [[1, 0, 0]], held=tuple(catalog.items))) is None


@settings(max_examples=60)
@given(st.data())
def test_policies_are_functions_of_the_state(data: st.DataObject) -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    share = data.draw(st.lists(st.floats(0, 1), min_size=3, max_size=3))
    count = data.draw(st.integers(0, len(catalog.items)))
    held = missing(state_of(catalog, [share], held=()), catalog.items)[:count]
    state = state_of(catalog, [share] * 2, data.draw(st.floats(1, 1e7)), tuple(held))
    for rule in POLICIES:
        key = rule(state)
        assert key == rule(state)
        assert (key is None) == (count == len(catalog.items))
        assert key is None or set(catalog.items[key].needs) <= set(held)


def test_the_throughput_rule_takes_the_highest_level_that_fits_its_time() -> None:
    catalog = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    held = (BASE, Key(1, SHARED))
    # Level 1 of one region: 1,000 bytes; level 2 besides: 100 + 1,000 more. Four seconds, 90 %.
    for rate, key in ((584, Key(2, SHARED)), (582, Key(1, 0)), (10, Key(1, 0))):
        state = state_of(catalog, [[1, 0, 0]], rate=rate, held=held)
        assert policy.throughput(state) in {key, Key(1, 0)}
        found = policy.bundles(state)
        assert policy.weight(state, found[2]) == 2100
        assert policy.weight(state, found[1]) == 1000
    fast = state_of(catalog, [[1, 0, 0]], rate=584, held=(*held, Key(1, 0)))
    assert policy.throughput(fast) == Key(2, SHARED)


def test_the_estimate_is_the_smaller_of_two_averages() -> None:
    assert estimate(()) == policy.START_RATE
    assert estimate([Sample(5000, 1.0)] * 9) == pytest.approx(5000)
    falling = [Sample(9000, 1.0)] * 20 + [Sample(1000, 1.0)] * 3
    rising = falling[::-1]
    fast = [0.5 ** (1 / 3), 0.5 ** (1 / 8)]
    after = [1000 + 8000 * keep**3 * (1 - keep**20) / (1 - keep**23) for keep in fast]
    assert estimate(falling) == pytest.approx(min(after))
    assert estimate(falling) == pytest.approx(after[0])
    assert estimate(rising) < 9000


def test_robust_mpc_distrusts_a_link_that_varies() -> None:
    assert robust_rate([Sample(1000, 1.0)] * 5) == pytest.approx(1000)
    mixed = [Sample(1000, 1.0), Sample(3000, 1.0)]
    assert robust_rate(mixed) == pytest.approx(1500 / 1.5)
