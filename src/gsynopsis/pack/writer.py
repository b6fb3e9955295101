"""A `LevelSet` to bytes and to a file, atomically, with an account of every byte and every loss."""

import contextlib
import errno
import os
import shutil
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError, LayoutError, SettingError, SpaceError, ValueRangeError
from gsynopsis.pack import layout
from gsynopsis.pack.codecs import CODINGS, Array, encode_array
from gsynopsis.pack.index import (
    Index,
    Want,
    check_chunks,
    check_levels,
    check_ranges,
    name_of,
    pack_index,
    plan,
    shapes_of,
)
from gsynopsis.pack.layout import ChunkEntry, CodingId, Header, Kind, LevelEntry
from gsynopsis.pack.manifest import write_manifest
from gsynopsis.records import Level, LevelSet

Coding = Literal["raw", "compact"]

COMPACT = {
    Kind.LATTICE: (CodingId.MORTON, CodingId.DELTA),
    Kind.MANIFEST: (CodingId.SHUFFLE,),
    Kind.CODES: (CodingId.SHUFFLE,),
    Kind.MASK: (CodingId.SHUFFLE,),
}
"""Codings of `compact` by kind, the first that fits is taken; all other kinds: `FLOATS`."""
FLOATS = (CodingId.HALF, CodingId.SHUFFLE)
"""Half precision; a chunk with a value beyond its range is stored without loss instead."""


@dataclass(frozen=True)
class PartSize:
    """One chunk in the account.

    Attributes:
        level: The level that pays for it.
        kind: Name of its kind, as in docs/format.md.
        coding: Name of its coding.
        stored: Bytes in the file.
        raw: Bytes before deflating.
        values: Numbers in it.
        error: Largest absolute difference between a value given and the value a reader gets.
    """

    level: int
    kind: str
    coding: str
    stored: int
    raw: int
    values: int
    error: float


@dataclass(frozen=True)
class SizeAccount:
    """Where the bytes of a file went; header, tables and parts sum up to `total` exactly."""

    index: int
    parts: tuple[PartSize, ...]

    @property
    def total(self) -> int:
        """Length of the file, bytes."""
        return self.index + sum(part.stored for part in self.parts)

    def delta(self, level: int) -> int:
        """Bytes that a level adds; header and tables count for level 0."""
        own = sum(part.stored for part in self.parts if part.level == level)
        return own + (0 if level else self.index)

    def error(self, kind: str) -> float:
        """Largest absolute error among the chunks of a kind."""
        return max((part.error for part in self.parts if part.kind == kind), default=0.0)


def write_gsyn(levels: LevelSet, path: Path | str, coding: Coding = "compact") -> SizeAccount:
    """Write a file: complete and under its own name, or not at all.

    Args:
        levels: What to write; not modified. Offsets of slots that are not live at the finest
            level, and grids that no level reads, are not part of a file.
        path: The file; an existing one is replaced.
        coding: `raw` keeps every bit of float32, `compact` is about a sixth of that.

    Raises:
        SpaceError: the disk has no room for it.
        ValueRangeError: a value is not finite.
        LayoutError: it is beyond a limit of docs/format.md.
        InputError: the path can not be written.
    """
    path = Path(path)
    data, account = encode_with_account(levels, coding, str(path))
    try:
        _publish(data, path)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise _no_space(path, len(data)) from error
        raise InputError(path, found=error.strerror or error, expected="a writable path") from error
    return account


def encode(levels: LevelSet, coding: Coding = "compact") -> bytes:
    """The bytes that `write_gsyn` writes; the same bytes for the same set."""
    return encode_with_account(levels, coding)[0]


def encode_with_account(
    levels: LevelSet, coding: Coding = "compact", where: str = "scene.gsyn"
) -> tuple[bytes, SizeAccount]:
    """The bytes of a file and where they went; `where` names it in messages."""
    if coding not in ("raw", "compact"):
        raise SettingError("coding", found=coding, expected="raw or compact")
    source = _Source(levels, where)
    header, entries = source.header, source.entries
    check_levels(header, entries, where)
    wants = plan(header, entries)
    header = header._replace(chunks=len(wants))
    check_ranges(header, "header", where)
    offset = layout.index_bytes(len(entries), len(wants))
    chunks: list[ChunkEntry] = []
    parts: list[PartSize] = []
    body: list[bytes] = []
    ends = [0] * len(entries)
    for want in wants:
        chunk, stored, part = _encode_chunk(want, source, coding)
        chunks.append(chunk._replace(offset=offset))
        parts.append(part)
        body.append(stored)
        offset += len(stored)
        ends[want.level] = offset
    entries = tuple(e._replace(end=end) for e, end in zip(entries, ends, strict=True))
    index = Index(header, entries, tuple(chunks))
    check_chunks(index, where)
    head = pack_index(index)
    return b"".join([head, *body]), SizeAccount(len(head), tuple(parts))


class _Source:
    """The arrays of a level set by chunk, and the tables without positions."""

    def __init__(self, levels: LevelSet, where: str) -> None:
        self.levels, self.where = levels, where
        frame, shared, last = levels.frame, levels.shared, levels.levels[-1]
        self.header = Header(
            magic=layout.MAGIC,
            version=layout.VERSION,
            required=0,
            levels=len(levels.levels),
            chunks=2,
            slots=shared.slots,
            features=int(shared.grids[0].shape[1]) if last.grids else 0,
            residual=int(shared.residual.shape[1]),
            contract=int(frame.contract),
            crc=0,
            voxel=float(frame.voxel),
            center_x=float(frame.center[0]),
            center_y=float(frame.center[1]),
            center_z=float(frame.center[2]),
            radius=float(frame.radius),
            extent=float(frame.extent),
        )
        check_ranges(self.header, "header", where)
        self.entries = tuple(_entry(level) for level in levels.levels)
        for number, level in enumerate(levels.levels):
            self._check_fusion(number, level)

    def array(self, want: Want) -> Array:
        """The array of a chunk, [rows, columns]; may be a view of the caller's."""
        level = self.levels.levels[want.level]
        match want.kind:
            case Kind.MANIFEST:
                text = write_manifest(self.levels, self.where)
                return np.frombuffer(text, np.uint8)[:, None]
            case Kind.NETWORKS:
                names = shapes_of(self.header, self.entries[want.level])
                return np.concatenate([level.networks[name].ravel() for name in names])[:, None]
            case Kind.CODEBOOK:
                return level.codebook
            case Kind.GRID:
                return self.levels.shared.grids[want.part]
            case Kind.MASK:
                bits = level.mask[~self._before(want.level)]
                return np.packbits(bits, bitorder="little")[:, None]
            case Kind.OFFSETS:
                live = level.mask & ~self._before(want.level)
                return self.levels.shared.offsets[: level.anchors][live]
            case _:
                return self._rows(want)

    def _rows(self, want: Want) -> Array:
        """What each new anchor of a level brings, one row for each."""
        shared = self.levels.shared
        before = self.entries[want.level - 1].anchors if want.level else 0
        rows = slice(before, self.entries[want.level].anchors)
        columns = {
            Kind.LATTICE: shared.lattice,
            Kind.LOG_SCALES: shared.log_scales,
            Kind.CODES: shared.codes[:, None],
            Kind.RESIDUAL: shared.residual,
        }
        return columns[want.kind][rows]

    def _before(self, number: int) -> NDArray[np.bool_]:
        """The parent's mask with rows of zeros for anchors that are new at this level."""
        before = np.zeros_like(self.levels.levels[number].mask)
        if number:
            parent = self.levels.levels[number - 1].mask
            before[: len(parent)] = parent
        return before

    def _check_fusion(self, number: int, level: Level) -> None:
        if "fuse_b1" in level.networks and not self.entries[number].fuse_hidden:
            field = f"level {number}: fuse_hidden"
            raise LayoutError(self.where, field, found=0, expected="at least 1")


def _entry(level: Level) -> LevelEntry:
    fused = "fuse_b1" in level.networks
    return LevelEntry(
        end=1,
        anchors=level.anchors,
        live=level.live,
        grids=level.grids,
        head_hidden=len(level.networks["opacity_b1"]),
        fuse_hidden=len(level.networks["fuse_b1"]) if fused else 0,
        fuse_out=len(level.networks["fuse_b2"]) if fused else 0,
        codebook_rows=int(level.codebook.shape[0]),
        codebook_columns=int(level.codebook.shape[1]),
        gain_x=float(level.gain[0]),
        gain_y=float(level.gain[1]),
        gain_z=float(level.gain[2]),
    )


def _encode_chunk(
    want: Want, source: _Source, coding: Coding
) -> tuple[ChunkEntry, bytes, PartSize]:
    array = source.array(want)
    grid = want.kind is Kind.GRID
    resolution = int(source.levels.shared.grid_resolutions[want.part]) if grid else 0
    entry = ChunkEntry(
        kind=int(want.kind),
        level=want.level,
        coding=0,
        reserved=0,
        part=want.part,
        offset=0,
        stored=1,
        raw=1,
        rows=array.shape[0],
        columns=array.shape[1],
        crc=0,
        resolution=resolution,
    )
    check_ranges(entry, name_of(entry), source.where)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        bad = array[~np.isfinite(array)][0]
        raise ValueRangeError(source.where, name_of(entry), found=bad, expected="finite values")
    choices = (CodingId.PLAIN,) if coding == "raw" else COMPACT.get(want.kind, FLOATS)
    chosen = next(c for c in choices if CODINGS[c].fits(array))
    encoded = encode_array(chosen, array)
    stored, raw = encoded.stored, encoded.raw
    entry = entry._replace(coding=int(chosen), stored=len(stored), raw=raw, crc=zlib.crc32(stored))
    part = PartSize(
        level=want.level,
        kind=want.kind.label,
        coding=chosen.label,
        stored=len(stored),
        raw=raw,
        values=array.size,
        error=encoded.error,
    )
    return entry, stored, part


def _publish(data: bytes, path: Path) -> None:
    """Write beside the final name, make it durable, rename; on any failure leave nothing."""
    if shutil.disk_usage(path.parent).free < len(data):
        raise _no_space(path, len(data))
    aside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with aside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise


def _no_space(path: Path, length: int) -> SpaceError:
    free = shutil.disk_usage(path.parent).free
    advice = "free some space or choose another folder"
    return SpaceError(path, "disk", found=f"{free} bytes", expected=f"{length}", advice=advice)
