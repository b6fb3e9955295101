"""Sums of rows of small codebooks: what weights and the price of a bit do."""

import numpy as np
import pytest
from numpy.typing import NDArray

from gsynopsis.model.residual_vq import ENTRIES, SAMPLE, encode_stages, learn_stages
from gsynopsis.records import Float32


def decoded(codes: NDArray[np.uint8], books: list[Float32]) -> Float32:
    parts = [book[codes[:, stage]] for stage, book in enumerate(books)]
    return np.stack(parts).sum(axis=0)


def entropy(codes: NDArray[np.uint8]) -> float:
    often = np.bincount(codes.ravel()) / codes.size
    return float(-(often[often > 0] * np.log2(often[often > 0])).sum())


@pytest.fixture
def vectors(rng: np.random.Generator) -> Float32:
    return rng.normal(0, rng.gamma(0.5, 1, (3000, 1)), (3000, 9)).astype(np.float32)


def test_more_stages_err_less_and_the_first_row_is_zero(vectors: Float32) -> None:
    weights = np.ones(len(vectors))
    errors = list[float]()
    for count in (1, 2, 4):
        books = learn_stages(vectors, weights, count, 32)
        assert all(book.shape == (32, 9) and not book[0].any() for book in books)
        codes = encode_stages(vectors, books, weights, 0)
        errors.append(float(np.square(vectors - decoded(codes, books)).mean()))
    assert float(np.square(vectors).mean()) > errors[0] > errors[1] > errors[2]


def test_without_a_price_codes_are_the_nearest_rows(vectors: Float32) -> None:
    books = learn_stages(vectors, np.ones(len(vectors)), 2, 16)
    codes = encode_stages(vectors, books, np.ones(len(vectors)), 0)
    left = vectors.astype(np.float64)
    for stage, book in enumerate(books):
        squares = np.square(left[:, None] - book[None]).sum(axis=2)
        chosen = squares[np.arange(len(left)), codes[:, stage]]
        assert chosen == pytest.approx(squares.min(axis=1), rel=1e-4, abs=1e-5)
        left -= book[codes[:, stage]]


def test_vectors_that_matter_are_met_better(vectors: Float32) -> None:
    matters = np.arange(len(vectors)) % 10 == 0
    errors = list[float]()
    for weights in (np.ones(len(vectors)), np.where(matters, 1.0, 1e-3)):
        books = learn_stages(vectors, weights, 2, 32)
        shown = decoded(encode_stages(vectors, books, weights, 0), books)
        errors.append(float(np.square(vectors - shown)[matters].mean()))
    assert errors[1] < 0.7 * errors[0]


def test_a_price_saves_bits_where_errors_matter_least(
    vectors: Float32, rng: np.random.Generator
) -> None:
    weights = rng.gamma(0.3, 1, len(vectors))
    books = learn_stages(vectors, weights, 2, 64)
    mean = float((weights * np.square(vectors).sum(axis=1)).mean())
    plain, priced = (encode_stages(vectors, books, weights, p * mean) for p in (0, 0.01))
    assert entropy(priced) < 0.8 * entropy(plain)
    lost = [
        weights * np.square(vectors - decoded(codes, books)).sum(axis=1)
        for codes in (plain, priced)
    ]
    assert lost[1].sum() < lost[0].sum() + 0.05 * mean * len(vectors)
    light = weights < np.median(weights)
    assert (priced[light] == 0).mean() > (priced[~light] == 0).mean()


@pytest.mark.parametrize("weights", [0.0, 1.0])
def test_few_vectors_and_weights_of_zero_are_coded(
    weights: float, rng: np.random.Generator
) -> None:
    few = rng.normal(size=(3, 24)).astype(np.float32)
    each = np.full(3, weights)
    books = learn_stages(few, each, 2, ENTRIES)
    codes = encode_stages(few, books, each, 0)
    assert decoded(codes, books) == pytest.approx(few, abs=1e-5)
    assert encode_stages(few[:0], books, each[:0], 0.1).shape == (0, 2)


def test_a_sample_is_drawn_by_weight(rng: np.random.Generator) -> None:
    many = rng.normal(size=(SAMPLE + 1000, 3)).astype(np.float32)
    weights = np.where(np.arange(len(many)) < 64, 1.0, 0.0)
    books = learn_stages(many, weights, 1, 128)
    shown = decoded(encode_stages(many[:64], books, weights[:64], 0), books)
    assert np.square(many[:64] - shown).mean() < 0.005
    again = learn_stages(many, weights, 1, 128)
    assert np.array_equal(books[0], again[0])
