"""The tiny picture in the manifest: what is shown of it and what never is."""

import pytest

from gsynopsis.container.notes.poster import parse_poster, poster_text
from tests.container.posters import GOOD, REFUSED, webp


def test_a_small_picture_becomes_a_note_and_comes_back() -> None:
    data = webp(48, 32)
    text = poster_text(data)
    assert text
    assert parse_poster(text) == data


@pytest.mark.parametrize("name", GOOD)
def test_what_is_of_the_one_form_is_taken(name: str) -> None:
    assert parse_poster(GOOD[name]) is not None


@pytest.mark.parametrize("name", REFUSED)
def test_all_else_is_left_out(name: str) -> None:
    assert parse_poster(REFUSED[name]) is None


def test_a_picture_that_readers_would_not_show_makes_no_note() -> None:
    assert poster_text(webp(65, 32)) == ""
