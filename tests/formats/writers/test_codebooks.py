"""Codebooks beside plain searches over all entries."""

import numpy as np
import pytest

from gsynopsis.formats.writers import codebooks
from gsynopsis.formats.writers.codebooks import nearest, value_codebook, vector_codebook


def test_values_take_the_nearest_entry_and_are_near_it(rng: np.random.Generator) -> None:
    values = rng.standard_normal((5000, 3)).astype(np.float32)
    book, places = value_codebook(values)
    assert (np.diff(book) >= 0).all() and len(book) == 256 and places.shape == values.shape
    away = np.abs(values[..., None] - book)
    assert np.allclose(np.abs(values - book[places]), away.min(axis=-1))
    even = np.linspace(values.min(), values.max(), 256)
    by_even = np.abs(values[..., None] - even).min(axis=-1)
    assert np.square(values - book[places]).mean() < 0.8 * np.square(by_even).mean()


def test_few_values_far_away_have_entries_too(rng: np.random.Generator) -> None:
    values = rng.standard_normal(100_000).astype(np.float32)
    values[:9] = np.linspace(-20, 20, 9)
    book, places = value_codebook(values)
    assert float(np.abs(values - book[places]).max()) < 0.3


def test_equal_values_are_kept() -> None:
    book, places = value_codebook(np.full((7, 3), -2.5, np.float32))
    assert (book[places] == -2.5).all()


def test_vectors_have_the_nearest_of_their_part_and_less_error_than_chance(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(codebooks, "DISTANCES", 300 * 16)
    middles = 3 * rng.standard_normal((40, 9))
    vectors = (middles[rng.integers(40, size=4000)] + rng.standard_normal((4000, 9)) / 4).astype(
        np.float32
    )
    book, places = vector_codebook(vectors, 256)
    assert len(book) <= 256 and len(np.unique(places)) > 200
    error = np.square(vectors - book[places]).sum(axis=1).mean()
    label, away = nearest(vectors, book)
    plain = np.square(vectors[:, None] - book).sum(axis=2)
    assert np.allclose(plain[np.arange(4000), label], plain.min(axis=1), atol=1e-3)
    assert np.allclose(away, plain.min(axis=1), atol=1e-3)
    assert error < 1.1 * away.mean(), "an entry of another part is much nearer"
    chance = vectors[rng.choice(4000, 256, replace=False)]
    assert error < 0.9 * nearest(vectors, chance)[1].mean()
    again = vector_codebook(vectors, 256)
    assert np.array_equal(again[0], book) and np.array_equal(again[1], places)


def test_as_many_entries_as_vectors_keep_them(rng: np.random.Generator) -> None:
    vectors = rng.standard_normal((50, 9)).astype(np.float32)
    book, places = vector_codebook(vectors, 64)
    assert np.array_equal(book[places], vectors)


def test_vectors_that_are_alike_share_an_entry() -> None:
    vectors = np.zeros((3000, 9), np.float32)
    vectors[1000:] = 1
    book, places = vector_codebook(vectors, 16)
    assert len(book) <= 16 and np.allclose(book[places], vectors)
