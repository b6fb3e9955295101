"""The compressed PLY of SuperSplat: chunks of 256 Gaussians, four numbers to a Gaussian.

Ours, because gaussforge 0.6 writes the harmonics coefficient by coefficient, where the format has
them colour by colour: readers of such a file get wrong colours.
"""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.axes import DOWN, Up
from gsynopsis.formats.readers.packed import CHUNK
from gsynopsis.formats.writers.ply import up_comments
from gsynopsis.records import SH_0, Float32, PlainGaussians, morton_order

SH_REACH = 4.0
"""Harmonics beyond the first are held from minus to plus this."""
LOG_SCALE_REACH = 20.0
"""Largest absolute log-scale that is stored (SuperSplat)."""
BOUNDS = ("", "scale_", "")
"""Between `min_` or `max_` and the axis in names of bounds: positions, scales, colours."""
AXES = ("xyz", "xyz", "rgb")
CELLS = 1 << 20
"""Along each axis, for the order of Gaussians: neighbours share a chunk."""
Float64 = NDArray[np.float64]


def packed_bytes(gaussians: PlainGaussians, *, up: Up = DOWN) -> bytes:
    """A compressed PLY.

    Args:
        gaussians: At least one; the file's are in Morton order of their positions.
        up: As of `ply_bytes`.
    """
    g, order = gaussians, neighbours(gaussians.means)
    color = g.sh[order, 0].astype(np.float64) * SH_0 + 0.5
    scales = np.clip(g.log_scales[order], -LOG_SCALE_REACH, LOG_SCALE_REACH).astype(np.float64)
    columns = (g.means[order].astype(np.float64), scales, color)
    bounds = [_bounds(column) for column in columns]
    shares = [_shares(c, *b) for c, b in zip(columns, bounds, strict=True)]
    opacity = 1 / (1 + np.exp(-g.logits[order].astype(np.float64)))
    vertex = np.stack(
        [
            _packed(shares[0], 11, 10, 11),
            _rotations(g.quaternions[order].astype(np.float64)),
            _packed(shares[1], 11, 10, 11),
            _packed(np.concatenate([shares[2], opacity[:, None]], axis=1), 8, 8, 8, 8),
        ],
        axis=1,
    )
    chunk = np.concatenate([end for low, high in bounds for end in (low, high)], axis=1)
    rest = g.sh[order, 1:].transpose(0, 2, 1).reshape(len(order), -1)
    header = _header(len(chunk), len(order), rest.shape[1], up)
    return b"".join(
        [header, chunk.astype("<f4").tobytes(), vertex.astype("<u4").tobytes(), _coarse(rest)]
    )


def neighbours(means: Float32) -> NDArray[np.int64]:
    """Rows in Morton order of a lattice over their box [G]."""
    low, high = means.min(axis=0), means.max(axis=0)
    size = float((high - low).max()) or 1.0
    cells = np.rint((means - low).astype(np.float64) / size * CELLS)
    return np.asarray(morton_order(cells.astype(np.int32)), np.int64)


def _bounds(values: Float64) -> tuple[Float64, Float64]:
    """Least and most of each chunk, as float32 holds them, [chunks, 3] each."""
    starts = np.arange(0, len(values), CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    return low.astype(np.float32).astype(np.float64), high.astype(np.float32).astype(np.float64)


def _shares(values: Float64, low: Float64, high: Float64) -> Float64:
    """Values as shares of the range between their chunk's bounds, in [0, 1]."""
    number = np.arange(len(values)) // CHUNK
    size = (high - low)[number]
    return np.clip((values - low[number]) / np.where(size > 0, size, 1), 0, 1)


def _packed(shares: Float64, *bits: int) -> NDArray[np.uint32]:
    """Columns as one number, the first in the highest bits."""
    packed = np.zeros(len(shares), np.uint32)
    for column, width in zip(shares.T, bits, strict=True):
        part = np.rint(column * ((1 << width) - 1)).astype(np.uint32)
        packed = (packed << np.uint32(width)) | part
    return packed


def _rotations(quaternions: Float64) -> NDArray[np.uint32]:
    """The place of the largest part, and the three others in ten bits each."""
    small, largest = smallest_three(quaternions)
    return (largest.astype(np.uint32) << np.uint32(30)) | _packed(small / 2**0.5 + 0.5, 10, 10, 10)


def smallest_three(quaternions: Float64) -> tuple[Float64, NDArray[np.int64]]:
    """Parts of quaternions beside the largest, which is made positive, and its place.

    Args:
        quaternions: Of any length above 0 [G, 4].

    Returns:
        Parts of the unit quaternions in order [G, 3], within ±√½, and 0 to 3 [G].
    """
    q = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    largest = np.abs(q).argmax(axis=1)
    rows = np.arange(len(q))
    q = q * np.where(q[rows, largest] < 0, -1, 1)[:, None]
    others = np.array([[i for i in range(4) if i != place] for place in range(4)])[largest]
    return np.take_along_axis(q, others, axis=1), largest


def _coarse(rest: Float32) -> bytes:
    share = rest.astype(np.float64) / (2 * SH_REACH) + 0.5
    return np.clip(np.floor(share * 256), 0, 255).astype(np.uint8).tobytes()


def _header(chunks: int, count: int, rest: int, up: Up) -> bytes:
    names = [
        f"{end}_{prefix}{axis}"
        for prefix, axes in zip(BOUNDS, AXES, strict=True)
        for end in ("min", "max")
        for axis in axes
    ]
    lines = ["ply", "format binary_little_endian 1.0", *up_comments(up)]
    lines += [f"element chunk {chunks}"]
    lines += [f"property float {name}" for name in names]
    lines += [f"element vertex {count}"]
    parts = ("position", "rotation", "scale", "color")
    lines += [f"property uint packed_{part}" for part in parts]
    if rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{k}" for k in range(rest))]
    return "\n".join([*lines, "end_header", ""]).encode()
