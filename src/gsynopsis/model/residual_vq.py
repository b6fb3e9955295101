"""Vectors as sums of rows of small codebooks: residual vector quantisation, stage by stage.

N vectors of H values, each with a weight: how much a squared error of it matters. Codebooks are
learnt by Lloyd's algorithm, codes chosen by weighted error and bits (entropy-constrained vector
quantisation; Chou, Lookabaugh and Gray 1989).
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.records import Float32

ENTRIES = 256
SAMPLE = 1 << 16
"""Vectors that codebooks are learnt from; drawn by their weight."""
ROUNDS = 8
"""Iterations of Lloyd's algorithm."""
PRICINGS = 2
"""Rounds in which a sample chooses codes by what they took in the round before."""
CHUNK = 1 << 16
"""Vectors that are assigned at once."""


def learn_stages(
    vectors: Float32, weights: NDArray[np.floating], count: int, entries: int
) -> list[Float32]:
    """Codebooks [entries, H] of `count` stages, each for the residual of the stages before.

    Args:
        vectors: [N, H], N > 0.
        weights: >= 0 [N]; if all are 0 they count alike.
        count: Stages.
        entries: Rows of each codebook, at most 256; the first is 0.
    """
    chance = np.random.default_rng(0)
    weights = np.asarray(weights, np.float64)
    share = weights / weights.sum() if weights.any() else np.full(len(weights), 1 / len(weights))
    if len(vectors) > SAMPLE:
        vectors = vectors[chance.choice(len(vectors), SAMPLE, p=share)]
        share = np.full(SAMPLE, 1 / SAMPLE)
    left = torch.from_numpy(np.ascontiguousarray(vectors, np.float32))
    books: list[Float32] = []
    for _ in range(count):
        book = _clustered(left, share, entries, chance)
        left = left - book[_squares(left, book).argmin(dim=1)]
        books.append(book.numpy())
    return books


def encode_stages(
    vectors: Float32, books: list[Float32], weights: NDArray[np.floating], price: float
) -> NDArray[np.uint8]:
    """Codes [N, S]: of each stage the row that errs and costs least, given the stages before.

    Args:
        vectors: [N, H].
        books: [entries, H] of each of S stages.
        weights: >= 0 [N].
        price: Weighted squared error that a bit is worth; 0: the nearest rows.
    """
    codes = np.zeros((len(vectors), len(books)), np.uint8)
    entries = [torch.from_numpy(np.ascontiguousarray(book)) for book in books]
    some = slice(None, None, max(1, -(-len(vectors) // SAMPLE)))
    prices = _prices(*_tensors(vectors, weights, some), entries, price)
    for first in range(0, len(vectors), CHUNK):
        part = slice(first, first + CHUNK)
        left, matter = _tensors(vectors, weights, part)
        for stage, book in enumerate(entries):
            chosen = _cheapest(left, book, matter, prices[stage])
            left -= book[chosen]
            codes[part, stage] = chosen.numpy()
    return codes


def _tensors(vectors: Float32, weights: NDArray[np.floating], rows: slice) -> tuple[Tensor, Tensor]:
    """Copies of some vectors and their weights."""
    return torch.tensor(vectors[rows]), torch.tensor(weights[rows], dtype=torch.float32)


def _prices(left: Tensor, weights: Tensor, books: list[Tensor], price: float) -> list[Tensor]:
    """Prices of the rows of each stage's codebook, by how often a sample takes them."""
    prices = list[Tensor]()
    for book in books:
        own = torch.zeros(len(book))
        for _ in range(PRICINGS if price else 0):
            often = _cheapest(left, book, weights, own).bincount(minlength=len(book)) + 0.5
            own = price * (often.sum() / often).log2()
        left = left - book[_cheapest(left, book, weights, own)]
        prices.append(own)
    return prices


def _cheapest(vectors: Tensor, book: Tensor, weights: Tensor, prices: Tensor) -> Tensor:
    """For each vector the row with the least sum of weighted squared error and price."""
    squares = _squares(vectors, book)
    if prices.any():
        squares = weights[:, None] * squares + prices
    return squares.argmin(dim=1)


def _clustered(
    vectors: Tensor, share: NDArray[np.float64], entries: int, chance: np.random.Generator
) -> Tensor:
    """The weighted means of `entries` clusters, but for the first, which is 0.

    Those without vectors begin again at the vectors that err most.
    """
    drawn = chance.choice(len(vectors), entries, p=share)
    book = vectors[torch.from_numpy(drawn)].clone()
    book[0] = 0
    weights = torch.from_numpy(share.astype(np.float32))
    lengths = vectors.square().sum(dim=1)
    for _ in range(ROUNDS):
        nearest, chosen = _squares(vectors, book).min(dim=1)
        sums = torch.zeros_like(book).index_add_(0, chosen, vectors * weights[:, None])
        sizes = torch.zeros(entries).index_add_(0, chosen, weights)
        book = torch.where(sizes[:, None] > 0, sums / sizes.clamp(min=1e-30)[:, None], book)
        empty = (sizes == 0).nonzero()[: len(vectors), 0]
        errors = weights * (nearest + lengths)
        book[empty] = vectors[errors.topk(len(empty)).indices]
        book[0] = 0
    return book


def _squares(vectors: Tensor, book: Tensor) -> Tensor:
    """Squared distances [N, entries], less the squared lengths of the vectors."""
    return book.square().sum(dim=1) - 2 * (vectors @ book.T)
