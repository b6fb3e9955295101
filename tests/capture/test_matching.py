"""Which photos are compared with which."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsynopsis.capture.matching import (
    first_pairs,
    is_ordered,
    resolve_matching,
    transitive_pairs,
)


def numbered(count: int, step: int = 1) -> list[str]:
    return [f"DSC{step * i:05d}.jpg" for i in range(count)]


def test_numbered_names_with_few_gaps_are_an_ordered_capture() -> None:
    assert is_ordered(numbered(20)) and is_ordered(numbered(20, 2))
    assert not is_ordered(numbered(20, 7))
    assert not is_ordered(["a1.jpg", "b2.jpg", "c3.jpg"])
    assert not is_ordered(["one.jpg", "two.jpg", "three.jpg"])


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        (numbered(60), "exhaustive"),
        (numbered(61), "sequential"),
        ([f"{i * 7919 % 10007:05d}.jpg" for i in range(250)], "exhaustive"),
        (sorted(f"{i * 7919 % 10007:05d}.jpg" for i in range(251)), "strides"),
    ],
    ids=["few", "ordered", "hundreds", "many"],
)
def test_the_way_of_matching_follows_number_and_names(names: list[str], wanted: str) -> None:
    assert resolve_matching(names) == wanted
    assert resolve_matching(names, "strides") == "strides"


@given(st.integers(3, 150), st.sampled_from(["exhaustive", "sequential", "strides"]))
def test_pairs_are_distinct_ascending_and_join_all_photos(count: int, matching: str) -> None:
    pairs = first_pairs(count, matching)  # type: ignore[arg-type]
    assert pairs == sorted(set(pairs))
    assert all(0 <= a < b < count for a, b in pairs)
    assert {(i, i + 1) for i in range(count - 1)} <= set(pairs)


def test_only_exhaustive_matching_grows_with_the_square() -> None:
    assert len(first_pairs(1000, "exhaustive")) == 499_500
    assert len(first_pairs(1000, "sequential")) < 20_000
    assert len(first_pairs(1000, "strides")) < 30_000


def test_friends_of_friends_are_new_pairs_with_a_photo_in_common() -> None:
    verified = [((0, 1), 90), ((1, 2), 80), ((5, 6), 70)]
    assert transitive_pairs(verified, [(0, 1), (1, 2), (5, 6)]) == [(0, 2)]
    assert transitive_pairs(verified, combinations(range(7), 2)) == []
