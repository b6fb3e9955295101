"""Bytes to a `LevelSet`, everything checked; deltas apply in order.

`Assembler` is the one decoder: a whole file, a prefix and a client that fetches chunk by chunk
all go through it, so they agree bit for bit.
"""

import math
import os
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import ChecksumError, InputError, LayoutError, TruncatedError, ValueRangeError
from gsynopsis.pack.codecs import Array, Bytes, CodecError, decode_array
from gsynopsis.pack.index import Index, check_length, name_of, parse_index, shapes_of
from gsynopsis.pack.layout import INDEX_BYTES_MAX, KINDS, ChunkEntry, CodingId, Kind
from gsynopsis.pack.manifest import read_manifest
from gsynopsis.records import Float32, Frame, Level, LevelSet, Shared


def decode(data: Bytes, source: str, level: int | None = None) -> LevelSet:
    """The level set in the bytes of a file, or of a prefix that ends after a level.

    Args:
        data: The bytes; not modified, not kept.
        source: What messages call them, usually the path.
        level: Last level wanted; None for all that the bytes hold.

    Raises:
        FormatError: the bytes break a promise of docs/format.md.
        InputError: the level is not in there.
    """
    view = memoryview(data)
    assembler = Assembler(view, source)
    last = _last_level(assembler.index, len(view), level, source)
    ends = assembler.index.levels
    for number in range(last + 1):
        assembler.add_level(view[assembler.index.start_of(number) : ends[number].end])
    return assembler.level_set()


def read_gsyn(path: Path | str, level: int | None = None) -> LevelSet:
    """The level set in a file; reads, and checks, only the bytes of the levels wanted.

    Args:
        path: A .gsyn file, or a prefix of one that ends after a level.
        level: Last level wanted; None for all that the file holds.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file or level.
    """
    source = str(path)
    try:
        with Path(path).open("rb") as file:
            length = os.fstat(file.fileno()).st_size
            index = parse_index(file.read(INDEX_BYTES_MAX), source)
            last = _last_level(index, length, level, source)
            file.seek(0)
            data = file.read(index.levels[last].end)
    except OSError as error:
        found = error.strerror or error
        raise InputError(path, found=found, expected="a readable .gsyn file") from error
    return decode(data, source)


def _last_level(index: Index, length: int, level: int | None, source: str) -> int:
    """The number of the last level to decode, from the length of what is there."""
    held = check_length(index, length, source)
    if level is None:
        return held - 1
    if not 0 <= level < held:
        raise InputError(source, "level", found=level, expected=f"0 to {held - 1}")
    return level


class Assembler:
    """A client's state: the index, then chunks in file order, and the levels they complete.

    It holds decoded pieces, never the bytes; what `level_set` returns is a copy that the caller
    owns. After an error the state is as before the call, so a chunk may be fetched again.

    Attributes:
        index: Header and tables: where each chunk lies.
        meta: Notes of the manifest, empty until its chunk, the first, is there.
        quality: Figures of the manifest for each level of the whole file, empty until then.
    """

    def __init__(self, head: Bytes, source: str) -> None:
        """Start from the first bytes of a file, at least header and tables.

        Args:
            head: 16 KiB are always enough; bytes after the tables are ignored.
            source: What messages call the file.

        Raises:
            FormatError: header or tables break a promise of docs/format.md.
        """
        self.index = parse_index(head, source)
        self._source = source
        self._next = 0
        self._arrays: dict[tuple[Kind, int, int], Array] = {}
        self._masks: list[NDArray[np.bool_]] = []
        self.meta: dict[str, str] = {}
        self.quality: list[dict[str, float]] = []

    @property
    def levels_ready(self) -> int:
        """How many levels are complete."""
        return len(self._masks)

    @property
    def next_chunk(self) -> ChunkEntry | None:
        """The chunk that `add` takes next, None when the file is complete."""
        return self.index.chunks[self._next] if self._next < len(self.index.chunks) else None

    @property
    def next_bytes(self) -> int:
        """Bytes still missing to complete the next level, 0 when the file is complete."""
        if self.next_chunk is None:
            return 0
        return self.index.levels[self.next_chunk.level].end - self.next_chunk.offset

    def add(self, stored: Bytes) -> None:
        """Take the bytes of the next chunk.

        Raises:
            FormatError: they are not what the tables promise, or there is no next chunk.
        """
        chunk = self.next_chunk
        if chunk is None:
            raise LayoutError(self._source, found="a chunk after the last")
        array = self._decoded(chunk, stored)
        key = (Kind(chunk.kind), chunk.level, chunk.part)
        self._arrays[key] = array
        last = self._next + 1 == len(self.index.chunks)
        if last or self.index.chunks[self._next + 1].level != chunk.level:
            self._masks.append(self._mask_of(chunk.level))
        self._next += 1

    def add_level(self, data: Bytes) -> None:
        """Take all bytes that are missing to complete the next level.

        Raises:
            FormatError: as `add`, or the length is not `next_bytes`.
        """
        if len(data) != self.next_bytes:
            found, expected = f"{len(data)} bytes", f"{self.next_bytes}"
            raise TruncatedError(
                self._source, f"level {self.levels_ready}", found=found, expected=expected
            )
        view, goal = memoryview(data), self.levels_ready + 1
        while self.levels_ready < goal and self.next_chunk is not None:
            stored = self.next_chunk.stored
            self.add(view[:stored])
            view = view[stored:]

    def level_set(self) -> LevelSet:
        """All complete levels.

        Raises:
            LayoutError: no level is complete.
        """
        if not self._masks:
            raise LayoutError(self._source, found="no complete level")
        levels = tuple(self._level(number) for number in range(self.levels_ready))
        try:
            return LevelSet(self._frame(), self._shared(), levels, dict(self.meta))
        except ValueError as error:
            raise LayoutError(self._source, found=error) from error

    def _decoded(self, chunk: ChunkEntry, stored: Bytes) -> Array:
        """The array of a chunk, checked on its own and against the tables."""
        where, kind = name_of(chunk), Kind(chunk.kind)
        if len(stored) != chunk.stored:
            found, expected = f"{len(stored)} bytes", f"{chunk.stored}"
            raise TruncatedError(self._source, where, found=found, expected=expected)
        crc = zlib.crc32(stored)
        if crc != chunk.crc:
            found, expected = f"CRC-32 {crc:08x}", f"{chunk.crc:08x}"
            advice = "the bytes were changed; fetch the file again"
            raise ChecksumError(self._source, where, found=found, expected=expected, advice=advice)
        shape, dtype = (chunk.rows, chunk.columns), KINDS[kind].dtype
        try:
            array = decode_array(CodingId(chunk.coding), stored, chunk.raw, shape, dtype)
        except CodecError as error:
            raise LayoutError(self._source, where, found=error) from error
        self._check_values(chunk, array)
        return array

    def _check_values(self, chunk: ChunkEntry, array: Array) -> None:
        where, kind = name_of(chunk), Kind(chunk.kind)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            row = int(np.argmin(np.isfinite(array).all(axis=1)))
            found = f"{array[row][~np.isfinite(array[row])][0]} in row {row}"
            raise ValueRangeError(self._source, where, found=found, expected="finite values")
        if kind is Kind.MANIFEST:
            levels = len(self.index.levels)
            manifest = read_manifest(array.tobytes(), levels, self._source)
            self.meta, self.quality = manifest

    def _mask_of(self, number: int) -> NDArray[np.bool_]:
        """The mask of a level whose chunks are all there, from the one before and its new bits."""
        entry, slots = self.index.levels[number], self.index.header.slots
        mask = np.zeros((entry.anchors, slots), np.bool_)
        old = self.index.levels[number - 1].anchors if number else 0
        if number:
            mask[:old] = self._masks[number - 1]
        packed = self._arrays.get((Kind.MASK, number, 0))
        where = f"level {number} mask"
        if packed is not None:
            bits = np.unpackbits(packed[:, 0], bitorder="little")
            off = np.flatnonzero(~mask)
            if bits[len(off) :].any():
                raise LayoutError(self._source, where, found="padding bits set", expected="zeros")
            mask.reshape(-1)[off] = bits[: len(off)].view(np.bool_)
        live = int(mask.sum())
        if live != entry.live:
            found = f"{live} live slots"
            raise LayoutError(self._source, where, found=found, expected=entry.live)
        some = mask[old:].any(axis=1)
        if not some.all():
            row = old + int(np.argmin(some))
            raise LayoutError(self._source, where, found=f"anchor {row} without a live slot")
        self._check_codes(number)
        return mask

    def _check_codes(self, number: int) -> None:
        rows = self.index.levels[number].codebook_rows
        for level in range(number + 1):
            codes = self._arrays.get((Kind.CODES, level, 0))
            if codes is not None and int(codes.max()) >= rows:
                where, expected = f"level {level} codes", f"below {rows} at level {number}"
                raise ValueRangeError(
                    self._source, where, found=int(codes.max()), expected=expected
                )

    def _frame(self) -> Frame:
        header = self.index.header
        center = np.array([header.center_x, header.center_y, header.center_z], np.float64)
        contract = bool(header.contract)
        return Frame(header.voxel, center, header.radius, contract, header.extent)

    def _shared(self) -> Shared:
        header, grids = self.index.header, self.index.levels[self.levels_ready - 1].grids
        chunks = [c for c in self.index.chunks if c.kind == Kind.GRID and c.part < grids]
        return Shared(
            lattice=self._rows(Kind.LATTICE, 3, np.int32),
            log_scales=self._rows(Kind.LOG_SCALES, 6, np.float32),
            offsets=self._offsets(),
            codes=self._rows(Kind.CODES, 1, np.uint8)[:, 0],
            residual=self._rows(Kind.RESIDUAL, header.residual, np.float32),
            grids=tuple(self._arrays[Kind.GRID, c.level, c.part].copy() for c in chunks),
            grid_resolutions=tuple(chunk.resolution for chunk in chunks),
        )

    def _rows(self, kind: Kind, columns: int, dtype: type[np.generic]) -> Array:
        """The rows of all complete levels, coarsest first; a copy."""
        rows = range(self.levels_ready)
        pieces = [self._arrays[kind, k, 0] for k in rows if (kind, k, 0) in self._arrays]
        anchors = self.index.levels[self.levels_ready - 1].anchors
        if not pieces:
            return np.zeros((0 if kind is Kind.CODES else anchors, columns), dtype)
        return np.concatenate(pieces).astype(dtype, copy=False)

    def _offsets(self) -> Float32:
        """Offsets of all anchors, zero where a slot is not live; each level fills what it adds."""
        shape = self._masks[-1].shape
        offsets = np.zeros((shape[0] * shape[1], 3), np.float32)
        for number, mask in enumerate(self._masks):
            values = self._arrays.get((Kind.OFFSETS, number, 0))
            if values is None:
                continue
            new = mask.copy()
            if number:
                before = self._masks[number - 1]
                new[: len(before)] &= ~before
            offsets[np.flatnonzero(new)] = values
        return offsets.reshape(*shape, 3)

    def _level(self, number: int) -> Level:
        header, entry = self.index.header, self.index.levels[number]
        codebook = self._arrays.get((Kind.CODEBOOK, number, 0))
        if codebook is None:
            codebook = np.zeros((entry.codebook_rows, entry.codebook_columns), np.float32)
        weights, at = self._arrays[Kind.NETWORKS, number, 0][:, 0], 0
        networks: dict[str, Float32] = {}
        for name, shape in shapes_of(header, entry).items():
            count = math.prod(shape)
            networks[name] = weights[at : at + count].reshape(shape).astype(np.float32)
            at += count
        gain = np.array([entry.gain_x, entry.gain_y, entry.gain_z], np.float32)
        return Level(
            mask=self._masks[number].copy(),
            grids=entry.grids,
            codebook=codebook.astype(np.float32),
            networks=networks,
            gain=gain,
            quality=dict(self.quality[number]),
        )
