"""Plain Gaussians as rows of a file: in nested levels, and rounded (ours).

Rows are ordered by worth; a level is the rows up to some number. Rounding is in uniform steps that
a coding finds again, harmonics become sums of rows of small codebooks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.model.residual_vq import ENTRIES, encode_stages, learn_stages
from gsynopsis.model.splats import joined_gaussians, rotations_of, ycocg_of
from gsynopsis.records import (
    HARMONICS,
    Float32,
    Frame,
    Level,
    LevelSet,
    PlainGaussians,
    Shared,
    morton_order,
)

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Steps:
    """Rounding steps of the values of splats; all are sums of few powers of two.

    Attributes:
        position: In shares of a small splat's middle scale.
        log_scale: Natural logarithms.
        rotation: Tangents of a quarter of the angle.
        logit: Opacities before the logistic function.
        luma: First coefficients of spherical harmonics, Y.
        chroma: First coefficients of spherical harmonics, Co and Cg.
        stages: Codes of the harmonics beyond the first.
        books: Most bytes of a level's codebooks, in shares of its rows' bytes.
        price: Weighted squared error of harmonics that a bit is worth, in shares of their weighted
            mean square.
    """

    position: float = 0.25
    log_scale: float = 1 / 16
    rotation: float = 1 / 128
    logit: float = 1 / 8
    luma: float = 1 / 32
    chroma: float = 1 / 32
    stages: int = 4
    books: float = 1 / 40
    price: float = 0.003


LOGIT_MOST = 6.0
"""Opacity 0.9975; renderers stop at an alpha of 0.99."""
LATTICE_MOST = (1 << 31) - 2
WORTH_LEAST = 1e-3
"""Worth that a Gaussian has at least when its harmonics are coded, in shares of the mean."""


def splat_levels(
    gaussians: PlainGaussians,
    worth: Float64,
    counts: Sequence[int],
    meta: Mapping[str, str],
    steps: Steps | None = None,
    always: int = 0,
    weights: Float64 | None = None,
) -> LevelSet:
    """Nested levels of splats.

    Args:
        gaussians: G of them.
        worth: Contribution of each to images; the highest come first [G].
        counts: Splats of each level, rising; the last is G.
        meta: Notes.
        steps: Rounding steps.
        always: Number of Gaussians at the front that are in every level.
        weights: How much a squared error of each one's harmonics matters [G]; None: by its worth.
    """
    steps = steps or Steps()
    weights = weights_by(worth) if weights is None else weights
    frame = frame_of(gaussians, steps)
    lattice = _lattice_of(gaussians, frame)
    order = _row_order(lattice, worth, counts, always)
    spans = spans_of(counts)
    codes, books = code_harmonics(gaussians, weights, order, spans, steps)
    books = [books[min(k, len(spans) - 1)] for k in range(len(counts))]
    shared = _shared_of(gaussians, lattice, order, codes, steps)
    return LevelSet(frame, shared, _levels(counts, books), dict(meta))


def _shared_of(
    gaussians: PlainGaussians,
    lattice: NDArray[np.int32],
    order: NDArray[np.int64],
    codes: NDArray[np.uint8],
    steps: Steps,
) -> Shared:
    return Shared(
        lattice=lattice[order],
        log_scales=_in_steps(gaussians.log_scales[order], steps.log_scale),
        offsets=np.zeros((len(order), 1, 0), np.float32),
        codes=codes,
        residual=_values(gaussians, order, steps),
        grids=(),
        grid_resolutions=(),
        degree=gaussians.degree,
    )


def _levels(counts: Sequence[int], books: Sequence[Float32]) -> tuple[Level, ...]:
    return tuple(
        Level(np.ones((n, 1), np.bool_), 0, book, {}, np.ones(3, np.float32))
        for n, book in zip(counts, books, strict=True)
    )


def levels_with_stand_ins(
    gaussians: PlainGaussians,
    worth: Float64,
    stand_ins: PlainGaussians,
    counts: Sequence[int],
    own: Sequence[int],
    meta: Mapping[str, str],
    steps: Steps,
) -> LevelSet:
    """Nested levels of stand-ins, and then nested ones of the splats, which take their place.

    Args:
        gaussians: G of them.
        worth: Contribution of each to images [G].
        stand_ins: Without harmonics beyond the first, those of level 0 first.
        counts: Stand-ins of each of their levels, rising.
        own: Splats of each level after these, rising; the last is G.
        meta: Notes.
        steps: Rounding steps.
    """
    frame = frame_of(gaussians, steps)
    # Stand-ins are larger, so their places may be coarser: low bits of the lattice are 0.
    coarse = steps.position * small_scale(stand_ins) / frame.voxel
    cell = 1 << int(np.clip(np.log2(max(coarse, 1.0)), 0, 16))
    lattices = [_lattice_of(stand_ins, frame, cell), _lattice_of(gaussians, frame)]
    lattice = np.concatenate(lattices)
    own_first = np.empty(len(gaussians), np.int64)
    own_first[np.argsort(-worth, kind="stable")] = _level_of_rows(own)
    first = np.concatenate([_level_of_rows(counts), len(counts) + own_first])
    order = _by_level(lattice, first)
    padded = np.zeros((len(stand_ins), *gaussians.sh.shape[1:]), np.float32)
    padded[:, :1] = stand_ins.sh
    joined = joined_gaussians([replace(stand_ins, sh=padded), gaussians])
    weights = np.concatenate([np.zeros(len(stand_ins)), weights_by(worth)])
    spans = [(len(stand_ins), len(lattice))]
    codes, (book,) = code_harmonics(joined, weights, order, spans, steps)
    levels = [*counts, *(len(stand_ins) + count for count in own)]
    books = [np.zeros((0, 0), np.float32)] * len(counts) + [book] * len(own)
    shared = replace(_shared_of(joined, lattice, order, codes, steps), stand_ins=len(counts))
    return LevelSet(frame, shared, _levels(levels, books), dict(meta))


def row_order(
    gaussians: PlainGaussians, worth: Float64, counts: Sequence[int], steps: Steps
) -> NDArray[np.int64]:
    """For each row of `splat_levels` the Gaussian that it is, int64 [G]; arguments as there."""
    return _row_order(_lattice_of(gaussians, frame_of(gaussians, steps)), worth, counts, 0)


def _row_order(
    lattice: NDArray[np.int32], worth: Float64, counts: Sequence[int], always: int
) -> NDArray[np.int64]:
    first = np.empty(len(lattice), np.int64)
    optional = np.arange(len(lattice)) >= always
    first[np.lexsort((-worth, optional))] = _level_of_rows(counts)
    return _by_level(lattice, first)


def _level_of_rows(counts: Sequence[int]) -> NDArray[np.int64]:
    """For each row of nested levels the level that brings it, [last of `counts`]."""
    return np.searchsorted(counts, np.arange(counts[-1]), side="right")


def _by_level(lattice: NDArray[np.int32], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows by the level that brings them, then along the Morton curve."""
    order = morton_order(lattice)
    return order[np.argsort(first[order], kind="stable")]


def _lattice_of(gaussians: PlainGaussians, frame: Frame, cell: int = 1) -> NDArray[np.int32]:
    lattice = cell * np.rint(gaussians.means.astype(np.float64) / (cell * frame.voxel))
    return np.clip(lattice, -LATTICE_MOST, LATTICE_MOST).astype(np.int32)


def small_scale(gaussians: PlainGaussians) -> float:
    """Middle scale of a small Gaussian, world units: one in ten has a smaller one."""
    middle = np.sort(gaussians.log_scales, axis=1)[:, 1].astype(np.float64)
    return float(np.exp(np.quantile(middle, 0.1)))


def frame_of(gaussians: PlainGaussians, steps: Steps) -> Frame:
    """Centre, size and lattice: cells are as small as small splats ask for."""
    small = small_scale(gaussians)
    means = gaussians.means.astype(np.float64)
    low, high = np.quantile(means, 0.05, axis=0), np.quantile(means, 0.95, axis=0)
    radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    farthest = float(np.abs(means).max())
    voxel = max(steps.position * small, farthest / LATTICE_MOST, radius / (1 << 20), 2.0**-60)
    return Frame(float(np.float32(voxel)), (low + high) / 2, radius, False, radius)


def _values(gaussians: PlainGaussians, order: NDArray[np.int64], steps: Steps) -> Float32:
    """Rotation, opacity and colour of each row, [G, 7]."""
    logits = np.clip(gaussians.logits[order], -LOGIT_MOST, LOGIT_MOST)
    color = ycocg_of(gaussians.sh[order, 0])
    turn = rotations_of(gaussians.quaternions[order])
    return np.concatenate(
        [
            _in_steps(turn, steps.rotation),
            _in_steps(logits[:, None], steps.logit),
            _in_steps(color[:, :1], steps.luma),
            _in_steps(color[:, 1:], steps.chroma),
        ],
        axis=1,
    )


def weights_by(worth: Float64) -> Float64:
    """Weights of squared errors of each Gaussian's harmonics, about 1 on average [G].

    The root, as images of other cameras show what those that it was measured in do not (chosen).
    """
    share = worth / max(float(worth.mean()), 1e-300)
    return np.sqrt(np.maximum(share, WORTH_LEAST))


def spans_of(counts: Sequence[int]) -> list[tuple[int, int]]:
    """First and last row, exclusive, of each codebook: the base has a smaller one of its own."""
    return [(0, counts[0]), (counts[0], counts[-1])] if len(counts) > 1 else [(0, counts[0])]


def code_harmonics(
    gaussians: PlainGaussians,
    weights: Float64,
    order: NDArray[np.int64],
    spans: Sequence[tuple[int, int]],
    steps: Steps,
) -> tuple[NDArray[np.uint8], list[Float32]]:
    """Codes of all rows [G, S], and a codebook [entries, S·H] for each span of rows.

    Args:
        gaussians: G of them, with H values of harmonics beyond the first.
        weights: As of `splat_levels`.
        order: For each row the Gaussian that it is [G].
        spans: Rows that share a codebook; others have none.
        steps: Of them `stages` S, `books` and `price` count.
    """
    width = HARMONICS[gaussians.degree]
    codes = np.zeros((len(order), steps.stages if width else 0), np.uint8)
    books = [np.zeros((0, 0), np.float32)] * len(spans)
    if not width:
        return codes, books
    rest = gaussians.sh[order, 1:].reshape(len(order), width)
    weights = weights[order]
    price = steps.price * float((weights * np.einsum("gh,gh->g", rest, rest)).mean())
    for number, (start, end) in enumerate(spans):
        if start == end:
            continue
        room = (end - start) * 16 * steps.books / (steps.stages * width)
        entries = int(np.clip(2 ** np.floor(np.log2(max(room, 1))), 1, ENTRIES))
        part, matter = rest[start:end], weights[start:end]
        book = as_stored(np.concatenate(learn_stages(part, matter, steps.stages, entries), axis=1))
        stages = list(np.split(book, steps.stages, axis=1))
        codes[start:end] = encode_stages(part, stages, matter, price)
        books[number] = book
    return codes, books


def as_stored(book: Float32) -> Float32:
    """A codebook in 255 steps to a column, which the coding finds again."""
    most = np.abs(book).max(axis=0, keepdims=True)
    step = 2.0 ** np.ceil(np.log2(np.maximum(most, 1e-6) / 127))
    return (np.rint(book / step) * step).astype(np.float32)


def _in_steps(values: Float32, step: float) -> Float32:
    return (np.rint(values.astype(np.float64) / step) * step).astype(np.float32)
