import pytest

from gsynopsis.model.training_focals import focals_text, parse_focals


def test_a_note_comes_back_to_the_last_bit() -> None:
    focals = [(171.4083043434829, 1e3 / 3), (0.1 + 0.2, 7.0)]
    assert parse_focals(focals_text(focals), 2) == focals
    # A prefix of a file has fewer levels than its note.
    assert parse_focals(focals_text(focals), 1) == focals[:1]


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        "[]",
        "7",
        "[[1,2]]",
        "[[1,2],[3]]",
        "[[1,2],[true,true]]",
        "[[1,2],[3,2]]",
        "[[1,2],[0,2]]",
        "[[1,2],[1,1e999]]",
        "[[1,2],[NaN,2]]",
        '[[1,2],["1","2"]]',
        "[[1,2],[1,2,3]]",
        '{"a": [1, 2]}',
        "[" * 100_000,
    ],
)
def test_what_is_no_note_is_ignored(text: str | None) -> None:
    assert parse_focals(text, 2) is None
