"""The note of block utilities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsynopsis.container.notes.block_utility import BLOCKS_MAX, parse_utility, utility_text


@given(st.lists(st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=20), min_size=1, max_size=4))
def test_utilities_come_back_within_an_eighth_of_a_decibel(utilities: list[list[float]]) -> None:
    text = utility_text([np.array(level) for level in utilities])
    found = parse_utility(text, [len(level) for level in utilities])
    assert found is not None
    for given_values, values in zip(utilities, found, strict=True):
        assert np.abs(10 * np.log10(values / np.array(given_values))).max() <= 0.125 + 1e-9


def test_a_utility_of_nothing_or_hardly_anything_is_zero() -> None:
    found = parse_utility(utility_text([np.array([0.0, 1e-9, 1.0, 7.0])]), [4])
    assert found is not None
    assert found[0].tolist() == [0.0, 0.0, 1.0, 1.0]


@pytest.mark.parametrize("text", ["", "AAA", "AA==", "AAAA AAAA", "ÄÄÄÄ", "AAAAAAAA"])
def test_a_note_that_does_not_fit_the_file_is_none(text: str) -> None:
    assert parse_utility(text, [2, 1]) is None


def test_a_note_is_at_most_4_kib() -> None:
    assert len(utility_text([np.ones(BLOCKS_MAX)])) == 4096
    assert utility_text([np.ones(BLOCKS_MAX), np.ones(1)]) == ""
    assert utility_text([]) == ""
