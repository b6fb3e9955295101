"""Vectors as sums of rows of small codebooks: residual vector quantisation, stage by stage."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.records import Float32

ENTRIES = 256
SAMPLE = 1 << 15
"""Vectors that a stage learns from; drawn by their weight."""
ROUNDS = 8
"""Iterations of Lloyd's algorithm."""
CHUNK = 1 << 16
"""Vectors that are assigned at once."""


def learn_stages(
    vectors: Float32, weights: NDArray[np.floating], count: int, entries: int, seed: int = 0
) -> list[Float32]:
    """Codebooks [entries, H] of `count` stages, each for the residual of the stages before.

    Args:
        vectors: [N, H].
        weights: How much an error of each matters, >= 0 [N].
        count: Stages.
        entries: Rows of each codebook, at most 256.
        seed: Of the sample.
    """
    chance = np.random.default_rng(seed)
    total = float(weights.sum())
    share = weights / total if total > 0 else None
    rows = chance.choice(len(vectors), SAMPLE, p=share) if len(vectors) > SAMPLE else slice(None)
    left = torch.from_numpy(np.ascontiguousarray(vectors[rows], np.float32))
    books: list[Float32] = []
    for _ in range(count):
        book = _clustered(left, entries, chance)
        left = left - book[_nearest(left, book)]
        books.append(book.numpy())
    return books


def encode_stages(vectors: Float32, books: list[Float32]) -> NDArray[np.uint8]:
    """Codes [N, S]: of each stage the row nearest to what the stages before leave."""
    codes = np.zeros((len(vectors), len(books)), np.uint8)
    tensors = [torch.from_numpy(book) for book in books]
    for first in range(0, len(vectors), CHUNK):
        left = torch.from_numpy(np.ascontiguousarray(vectors[first : first + CHUNK], np.float32))
        for stage, book in enumerate(tensors):
            chosen = _nearest(left, book)
            codes[first : first + CHUNK, stage] = chosen.numpy()
            left = left - book[chosen]
    return codes


def _clustered(vectors: Tensor, entries: int, chance: np.random.Generator) -> Tensor:
    """The means of `entries` clusters; the first is 0 to begin with, others are vectors."""
    starts = chance.choice(len(vectors), entries, replace=len(vectors) < entries)
    book = vectors[torch.from_numpy(starts)].clone()
    book[0] = 0
    for _ in range(ROUNDS):
        chosen = _nearest(vectors, book)
        sums = torch.zeros_like(book).index_add_(0, chosen, vectors)
        sizes = torch.bincount(chosen, minlength=entries).to(book)
        book = torch.where(sizes[:, None] > 0, sums / sizes.clamp(min=1)[:, None], book)
    return book


def _nearest(vectors: Tensor, book: Tensor) -> Tensor:
    return (book.square().sum(dim=1) - 2 * (vectors @ book.T)).argmin(dim=1)
