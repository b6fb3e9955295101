"""The packed PLY of SuperSplat: chunks of 256 Gaussians with bounds, four numbers to a Gaussian."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import logits_of, rest_names, shown
from gsynopsis.records import SH_0, Float32, PlainGaussians

CHUNK = 256
"""Gaussians that share bounds."""
Array = NDArray[Any]


def unpack(rows: dict[str, Array], path: Path) -> PlainGaussians:
    """The Gaussians of the elements `chunk`, `vertex` and, if there, `sh`.

    Raises:
        InputError: elements or properties do not fit.
    """
    vertex, chunk, sh = rows["vertex"], rows.get("chunk"), rows.get("sh")
    count = len(vertex)
    if chunk is None or len(chunk) != -(-count // CHUNK):
        found = f"{0 if chunk is None else len(chunk)} chunks"
        raise InputError(path, "chunk", found=found, expected=f"{-(-count // CHUNK)}")
    if sh is not None and len(sh) != count:
        raise InputError(path, "sh", found=f"{len(sh):,} rows", expected=f"{count:,}")
    number = np.arange(count) // CHUNK
    try:
        means = _between(_fields(vertex["packed_position"], 11, 10, 11), chunk, "", number)
        scales = _between(_fields(vertex["packed_scale"], 11, 10, 11), chunk, "scale_", number)
        color = _fields(vertex["packed_color"], 8, 8, 8, 8)
        if "min_r" in (chunk.dtype.names or ()):
            color[:, :3] = _between(color[:, :3], chunk, "", number, "rgb")
        turn = _rotations(vertex["packed_rotation"])
    except ValueError as error:
        raise InputError(path, "header", found=shown(error), expected="a packed PLY") from error
    first = (color[:, :3] - 0.5) / SH_0
    rest = _rest(sh, count, path)
    return PlainGaussians(
        means=means.astype(np.float32),
        log_scales=scales.astype(np.float32),
        quaternions=turn,
        logits=logits_of(color[:, 3]),
        sh=np.concatenate([first[:, None].astype(np.float32), rest], axis=1),
    )


def _fields(packed: Array, *bits: int) -> NDArray[np.float64]:
    """The parts of a 32-bit number, the highest first, each in [0, 1]."""
    values = np.asarray(packed, np.uint32)
    shift, parts = 32, list[Array]()
    for width in bits:
        shift -= width
        most = (1 << width) - 1
        parts.append(((values >> np.uint32(shift)) & np.uint32(most)) / most)
    return np.stack(parts, axis=1)


def _between(
    share: NDArray[np.float64], chunk: Array, prefix: str, number: Array, axes: str = "xyz"
) -> NDArray[np.float64]:
    low, high = (
        np.stack([chunk[f"{end}_{prefix}{axis}"] for axis in axes], axis=1).astype(np.float64)
        for end in ("min", "max")
    )
    return low[number] + share * (high - low)[number]


def _rotations(packed: Array) -> Float32:
    """Quaternions w x y z of their three smallest parts and the place of the largest."""
    values = np.asarray(packed, np.uint32)
    shifts = np.array([20, 10, 0], np.uint32)
    small = ((values[:, None] >> shifts) & np.uint32(1023)) / 1023 - 0.5
    return from_smallest(small * 2**0.5, values >> np.uint32(30))


def from_smallest(small: NDArray[np.floating], largest: Array) -> Float32:
    """Quaternions [G, 4] from the three parts that are not the largest, in order [G, 3].

    Args:
        small: Those parts.
        largest: Which part is the largest and > 0, 0 to 3 [G].
    """
    count = len(small)
    q = np.empty((count, 4), np.float32)
    left = np.sqrt(np.maximum(0, 1 - np.square(small).sum(axis=1)))
    for place in range(4):
        rows = largest == place
        others = [i for i in range(4) if i != place]
        q[np.ix_(rows, others)] = small[rows]
        q[rows, place] = left[rows]
    return q


def _rest(sh: Array | None, count: int, path: Path) -> Float32:
    if sh is None:
        return np.zeros((count, 0, 3), np.float32)
    names = rest_names(set(sh.dtype.names or ()), path)
    each = len(names) // 3
    found = np.empty((count, each, 3), np.float32)
    for channel in range(3):
        for i in range(each):
            byte = np.asarray(sh[names[channel * each + i]], np.float32)
            share = np.where(byte == 0, 0, np.where(byte == 255, 1, (byte + 0.5) / 256))
            found[:, i, channel] = (share - 0.5) * 8
    return found
