"""The `.ksplat` of mkkellogg's GaussianSplats3D: sections of rows, with the axes of 3DGS.

Rows are float32, or half floats with positions as whole numbers around the centre of a bucket. A
section lists its full buckets first; their rows follow each other in the same order.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.formats.readers.base import (
    SplatFile,
    check_count,
    check_room,
    cleaned,
    joined,
    logits_of,
)
from gsynopsis.records import HARMONICS, SH_0, Float32, PlainGaussians

HEAD_BYTES, SECTION_BYTES = 4096, 1024
HEAD = struct.Struct("<BBxxIIIIHxxfffff")
"""Version, sections that there may be and that are, splats likewise, level, centre, range of SH."""
SECTION = struct.Struct("<IIIIfHxxIIIIH")
"""Splats, their room, size and number of buckets, edge of a bucket, its bytes, half of the range of
positions, bytes, full and other buckets, degree."""
SH_RANGE = 1.5
"""Harmonics in a byte go from minus this to this, where the header has no range."""
PLACES = 32767
"""Half of the range of positions where a section has none."""
SECTIONS_MAX = 1 << 14
DEGREES = 3
"""Degrees of harmonics that the format has, 0 among them."""
BANDS = (3, 5)
"""Coefficients of each degree from 1 on; a file has red's of a degree, then green's and blue's."""


@dataclass(frozen=True)
class _Section:
    """Header of a section, and where its bytes begin."""

    count: int
    room: int
    bucket: int
    buckets: int
    edge: float
    bucket_bytes: int
    half_range: int
    full: int
    others: int
    degree: int
    start: int

    def rows_at(self) -> int:
        """The byte at which its rows begin."""
        return self.start + 4 * self.others + self.bucket_bytes * self.buckets


def read_ksplat(path: Path) -> SplatFile:
    """The Gaussians of a `.ksplat` file.

    Raises:
        InputError: it is damaged, of another version, or values are impossible.
    """
    with open_regular(path) as file:
        check_room(file.seek(0, 2), HEAD_BYTES, path, "header")
        data = np.memmap(file, np.uint8, "r").data
    major, minor, sections, _, _, count, level, *_, low, high = HEAD.unpack_from(data)
    if (major, minor) < (0, 1) or major > 0:
        raise InputError(path, "version", found=f"{major}.{minor}", expected="0.1")
    if level > 2:
        raise InputError(path, "compression", found=level, expected="0 to 2")
    check_count(count, path)
    if not 1 <= sections <= SECTIONS_MAX:
        raise InputError(path, "sections", found=f"{sections:,}", expected=f"1 to {SECTIONS_MAX:,}")
    low, high = low or -SH_RANGE, high or SH_RANGE
    parts = list[PlainGaussians]()
    start = HEAD_BYTES + sections * SECTION_BYTES
    check_room(len(data), start, path, "sections")
    for number in range(sections):
        section = _section(data, number, start, path)
        start = section.rows_at() + section.room * _row(level, section.degree).itemsize
        check_room(len(data), start, path, f"section {number}")
        if section.count:
            parts.append(_gaussians(data, section, level, (low, high), path))
    total = sum(map(len, parts))
    if total != count:
        raise InputError(path, "splats", found=f"{total:,} in sections", expected=f"{count:,}")
    return cleaned(SplatFile((joined(parts),), kind="ksplat"), path)


def _section(data: memoryview, number: int, start: int, path: Path) -> _Section:
    at = HEAD_BYTES + number * SECTION_BYTES
    count, room, bucket, buckets, edge, width, half, _, full, others, degree = SECTION.unpack_from(
        data, at
    )
    field = f"section {number}"
    if degree >= DEGREES:
        raise InputError(path, f"{field}: degree", found=degree, expected=f"0 to {DEGREES - 1}")
    if count > room or (buckets and (full + others > buckets or width < 12 or width % 4)):
        found = f"{count:,} splats of {room:,} in {full:,} + {others:,} of {buckets:,} buckets"
        raise InputError(path, field, found=found, expected="counts that fit each other")
    return _Section(
        count, room, bucket, buckets, edge, width, half or PLACES, full, others, degree, start
    )


def _row(level: int, degree: int) -> np.dtype[np.void]:
    """One splat: scales as they are, w x y z, colour and opacity from 0 to 255."""
    place, value, rest = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
    columns = [("mean", place, 3), ("scale", value, 3), ("turn", value, 4), ("color", "u1", 4)]
    return np.dtype([*columns, ("rest", rest, HARMONICS[degree])])


def _gaussians(
    data: memoryview, section: _Section, level: int, sh: tuple[float, float], path: Path
) -> PlainGaussians:
    kind = _row(level, section.degree)
    rows = np.frombuffer(data, kind, section.count, section.rows_at())
    means = rows["mean"].astype(np.float32)
    if level:
        step = section.edge / 2 / section.half_range
        means = ((means - section.half_range) * step + _centers(data, section, path)).astype("<f4")
    rest = rows["rest"].astype(np.float32)
    if level == 2:
        rest = sh[0] + rest / np.float32(255) * np.float32(sh[1] - sh[0])
    colors = rows["color"] / np.float32(255)
    first = ((colors[:, :3] - 0.5) / SH_0).astype(np.float32)
    return PlainGaussians(
        means=means,
        log_scales=np.log(rows["scale"].astype(np.float32)),
        quaternions=rows["turn"].astype(np.float32),
        logits=logits_of(colors[:, 3]),
        sh=np.concatenate([first[:, None], _harmonics(rest, section.degree)], axis=1),
    )


def _centers(data: memoryview, section: _Section, path: Path) -> NDArray[np.float32]:
    """The centre of each splat's bucket [count, 3]."""
    others = np.frombuffer(data, "<u4", section.others, section.start).astype(np.int64)
    sizes = np.concatenate([np.full(section.full, section.bucket, np.int64), others])
    ends = np.cumsum(sizes)
    if not len(ends) or int(ends[-1]) < section.count or int(sizes.max()) > section.room:
        found = f"buckets of {int(ends[-1]) if len(ends) else 0:,} splats"
        raise InputError(path, "buckets", found=found, expected=f"of {section.count:,}")
    width = section.bucket_bytes // 4
    start = section.start + 4 * section.others
    table = np.frombuffer(data, "<f4", width * section.buckets, start).reshape(-1, width)
    return table[np.searchsorted(ends, np.arange(section.count), side="right"), :3]


def _harmonics(rest: Float32, degree: int) -> Float32:
    """Coefficients beyond the first [count, C, 3]."""
    found, at = [np.zeros((len(rest), 0, 3), np.float32)], 0
    for width in BANDS[:degree]:
        band = rest[:, at : at + 3 * width].reshape(len(rest), 3, width)
        found.append(band.swapaxes(1, 2))
        at += 3 * width
    return np.concatenate(found, axis=1)
