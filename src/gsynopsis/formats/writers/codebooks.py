"""Codebooks of values and of vectors: what a SOG has for scales, colours and harmonics.

Letters: G vectors of D values, K of them in a codebook.
"""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.records import Float32

Int64 = NDArray[np.int64]
ENTRIES = 256
"""Values of a codebook of values."""
BINS = 1 << 16
"""Bins of the histogram that stands for all values."""
ROUNDS = 30
"""Rounds of Lloyd's algorithm over a histogram."""
VECTOR_ROUNDS = 8
"""Rounds of it over vectors."""
SAMPLE = 64
"""Vectors for each centroid of the first of two stages: more move it by little."""
DISTANCES = 1 << 22
"""Distances of vectors to centroids that are held at a time."""


def value_codebook(values: Float32) -> tuple[Float32, NDArray[np.uint8]]:
    """A codebook of single values and the entry of each (Lloyd, Max).

    Half of its weight is that of the values, half lies evenly between the least and the largest:
    a few huge Gaussians may fill an image.

    Args:
        values: Any shape, finite, at least one.

    Returns:
        Rising values, float32 [256], and places in them of the values' shape.
    """
    low, high = float(values.min()), float(values.max())
    if low == high:
        return np.full(ENTRIES, low, np.float32), np.zeros(values.shape, np.uint8)
    counts, edges = np.histogram(values, BINS, (low, high))
    middles, weights = (edges[:-1] + edges[1:]) / 2, counts + values.size / BINS
    # Where values are dense entries are, by the root that is best for many (Panter, Dite).
    dense = np.cumsum(np.cbrt(weights))
    shares = (np.arange(ENTRIES) + 0.5) / ENTRIES
    book = np.interp(shares * dense[-1], dense, middles)
    total, moment = (np.append(0.0, np.cumsum(part)) for part in (weights, weights * middles))
    for _ in range(ROUNDS):
        cuts = np.searchsorted(middles, (book[:-1] + book[1:]) / 2)
        ends = np.concatenate([[0], cuts, [BINS]])
        number, sums = np.diff(total[ends]), np.diff(moment[ends])
        book = np.where(number > 0, sums / np.maximum(number, 1), book)
    book = np.sort(book).astype(np.float32)
    places = np.searchsorted((book[:-1] + book[1:]) / 2, values.ravel())
    return book, places.astype(np.uint8).reshape(values.shape)


def vector_codebook(vectors: Float32, entries: int) -> tuple[Float32, Int64]:
    """A codebook of vectors and the entry of each, by k-means in two stages.

    A codebook of thousands of entries over a million vectors would take a processor hours: first
    come about the root of as many centroids, then those of the vectors of each, more where they
    are far from theirs.

    Args:
        vectors: [G, D], finite, at least one.
        entries: K ≥ 1.

    Returns:
        At most K vectors, float32 [K', D], and the entry of each vector, int64 [G].
    """
    chance = np.random.default_rng(0)
    if len(vectors) <= entries:
        return vectors.copy(), np.arange(len(vectors))
    first = round(entries**0.5)
    some = chance.choice(len(vectors), min(len(vectors), SAMPLE * first), replace=False)
    centers = _lloyd(vectors[some], first, chance)
    label, away = nearest(vectors, centers)
    sizes = np.bincount(label, minlength=len(centers))
    spread = np.asarray(np.bincount(label, away, len(centers)), np.float64)
    shares = _shared_out(entries, spread, sizes)
    order = np.argsort(label, kind="stable")
    ends = np.cumsum(sizes)
    books, places, before = list[Float32](), np.empty(len(vectors), np.int64), 0
    for size, end, share in zip(sizes.tolist(), ends.tolist(), shares.tolist(), strict=True):
        rows = order[end - size : end]
        if not size:
            continue
        book = vectors[rows] if share >= size else _lloyd(vectors[rows], share, chance)
        places[rows] = before + nearest(vectors[rows], book)[0]
        books.append(book)
        before += len(book)
    return np.concatenate(books), places


def nearest(vectors: Float32, centers: Float32) -> tuple[Int64, Float32]:
    """The nearest of some centres [K, D] to each vector [G, D], and its squared distance."""
    squares = np.square(centers).sum(axis=1)
    label = np.empty(len(vectors), np.int64)
    away = np.empty(len(vectors), np.float32)
    step = max(1, DISTANCES // len(centers))
    for start in range(0, len(vectors), step):
        rows = slice(start, start + step)
        some = vectors[rows]
        scores = squares - 2 * (some @ centers.T)
        label[rows] = own = scores.argmin(axis=1)
        away[rows] = scores[np.arange(len(some)), own] + np.square(some).sum(axis=1)
    return label, np.maximum(away, 0)


def _lloyd(vectors: Float32, count: int, chance: np.random.Generator) -> Float32:
    """Centres of some vectors, fewer than these; one that nothing is near stays where it was."""
    centers = vectors[chance.choice(len(vectors), count, replace=False)].copy()
    for _ in range(VECTOR_ROUNDS):
        label, _ = nearest(vectors, centers)
        sizes = np.bincount(label, minlength=count)
        order, used = np.argsort(label, kind="stable"), sizes > 0
        starts = (np.cumsum(sizes) - sizes)[used]
        sums = np.add.reduceat(vectors[order], starts, axis=0)
        centers[used] = sums / sizes[used, None].astype(np.float32)
    return centers


def _shared_out(total: int, spread: NDArray[np.float64], sizes: Int64) -> Int64:
    """Entries of each part: by its spread, one at least where it is not empty, its size at most."""
    shares = np.minimum(sizes, 1)
    while (left := total - int(shares.sum())) > 0:
        room = np.where(shares < sizes, np.maximum(spread, 1e-30), 0)
        if not room.any():
            break
        wanted = left * room / room.sum()
        more = np.minimum(np.floor(wanted).astype(np.int64), sizes - shares)
        if not more.any():
            more[np.argsort(-wanted, kind="stable")[:left]] = 1
            more = np.minimum(more, sizes - shares)
        shares = shares + more
    return shares
