"""The hand-made cases that the browser's policy is tested on too."""

import json

import pytest

from gsynopsis.stream.catalog import Key
from gsynopsis.stream.lookahead import ours, viewed_quality
from tests.stream.cases import FILE, RATE, cases, read

CASES = json.loads(FILE.read_text())


def test_the_committed_cases_are_those_made_by_hand() -> None:
    # Sums may differ in their last digits from one machine to another.
    found, kept = (json.dumps(_rounded(content)) for content in (cases(), CASES))
    assert found == kept, "run python -m tests.stream.cases"


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_ours_answers_well_and_counts_quality_as_a_viewer_sees_it(case: dict) -> None:
    state = read(case["state"])
    choice = ours(state)
    assert choice is not None and list(choice) in case["good"]
    for order, value in case["orders"]:
        keys = [Key(*key) for key in order]
        assert viewed_quality(state, keys, RATE) == pytest.approx(value, rel=1e-6)
