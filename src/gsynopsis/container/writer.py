"""A `LevelSet` to bytes and to a file, atomically, with an account of every byte and every loss."""

import shutil
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsynopsis import files
from gsynopsis.container import layout
from gsynopsis.container.codecs import NotFiniteError, deflate
from gsynopsis.container.coding import Coding, CodingPlan, Quantizer, plan_for
from gsynopsis.container.directory import pack_directory
from gsynopsis.container.encode_level import LevelPieces, PartSize, cut_pieces
from gsynopsis.container.index import (
    Index,
    Want,
    check_chunks,
    check_levels,
    check_ranges,
    first_shared,
    name_of,
    pack_index,
    plan,
)
from gsynopsis.container.layout import ChunkEntry, CodingId, Header, Kind, LevelEntry
from gsynopsis.container.manifest import manifest_text
from gsynopsis.container.pages import PAGE_BLOCKS, LevelPages, cut_pages, in_pages
from gsynopsis.container.spatial import BASE_ANCHORS, BLOCK_ANCHORS, blocks_of_levels, sorted_levels
from gsynopsis.container.values import (
    decode_networks,
    decode_values,
    encode_networks,
    encode_values,
)
from gsynopsis.errors import LayoutError, SpaceError, ValueRangeError
from gsynopsis.records import Float32, LevelSet


@dataclass(frozen=True)
class SizeAccount:
    """Account of a file's bytes; header, tables and parts sum up to `total` exactly.

    Attributes:
        index: Bytes of header and tables.
        parts: Every other byte, by level and kind.
        ends: File offset where each level ends.
    """

    index: int
    parts: tuple[PartSize, ...]
    ends: tuple[int, ...]

    @property
    def total(self) -> int:
        """Length of the file, bytes."""
        return self.index + sum(part.stored for part in self.parts)

    def delta(self, level: int) -> int:
        """Bytes from the end of the level before to the end of this one."""
        return self.ends[level] - (self.ends[level - 1] if level else 0)

    def error(self, kind: str) -> float:
        """Largest absolute error among the parts of a kind."""
        return max((part.error for part in self.parts if part.kind == kind), default=0.0)


class _Chunk(NamedTuple):
    """An entry without its position, its bytes, and its line (or lines) in the account."""

    entry: ChunkEntry
    body: bytes
    parts: tuple[PartSize, ...]


def write_gsyn(
    levels: LevelSet,
    path: Path | str,
    coding: Coding | CodingPlan = "compact",
    block: int = BLOCK_ANCHORS,
    base: int = BASE_ANCHORS,
) -> SizeAccount:
    """Write a file: complete and under its own name, or not at all.

    Args:
        levels: What to write; not modified. Offsets of slots that are not live at the finest
            level, and grids that no level reads, are not part of a file. Rows that are not in
            the order of the blocks are sorted.
        path: The file; an existing one is replaced.
        coding: `raw` keeps every bit of float32; `compact` is a fraction of that.
        block: Largest number of anchors of a spatial block.
        base: The same for blocks of level 0, if that is less.

    Raises:
        SpaceError: the disk has no room for it.
        ValueRangeError: a value is not finite.
        LayoutError: it is beyond a limit of docs/format.md.
        InputError: the path can not be written.
    """
    path = Path(path)
    data, account = encode_with_account(levels, coding, str(path), block, base)
    publish(data, path)
    return account


def encode(levels: LevelSet, coding: Coding | CodingPlan = "compact") -> bytes:
    """The bytes that `write_gsyn` writes; the same bytes for the same set."""
    return encode_with_account(levels, coding)[0]


def encode_with_account(
    levels: LevelSet,
    coding: Coding | CodingPlan = "compact",
    where: str = "scene.gsyn",
    block: int = BLOCK_ANCHORS,
    base: int = BASE_ANCHORS,
    page: int = PAGE_BLOCKS,
) -> tuple[bytes, SizeAccount]:
    """The bytes of a file and where they went; `where` names it in messages.

    Args:
        levels: What to write.
        coding: A plan or its name.
        where: What messages call the file.
        block: Largest number of anchors of a spatial block.
        base: The same for blocks of level 0, if that is less.
        page: Records of a page of a directory, where one is too long to stay whole.
    """
    levels = sorted_levels(levels, block, base)
    chosen = plan_for(levels, coding)
    by_level = blocks_of_levels(levels, block, base)
    entries = tuple(
        _entry(levels, number, chosen, len(blocks.parent), where)
        for number, blocks in enumerate(by_level)
    )
    header = _header(levels, where)
    if any(entry.inherits for entry in entries):
        header = header._replace(required=header.required | layout.TIED_WEIGHTS)
    # Before the pieces are made, which takes longest.
    check_levels(header, entries, where)
    pieces = [cut_pieces(levels, k, blocks, chosen, where) for k, blocks in enumerate(by_level)]
    pages = None
    if in_pages(pieces, page):
        header = header._replace(required=header.required | layout.PAGES)
        pages = cut_pages(pieces, page)
    source = _Source(levels, header, entries, pieces, chosen, where, pages)
    chunks = {want: source.chunk(want) for want in plan(header, entries)}
    front = [c for want, c in chunks.items() if want.kind in (Kind.MANIFEST, Kind.DIRECTORY)]
    # Small directories stand in front, so that a client's first request brings them; large ones
    # stay with their levels and do not delay the base.
    head = layout.index_bytes(len(entries), len(chunks)) + sum(len(c.body) for c in front)
    header = header._replace(chunks=len(chunks), front=int(head <= layout.INDEX_BYTES_MAX))
    if header.front:
        # A client receives them before level 0 ends, whatever level they are of.
        chunks = {want: _counted_at_base(want, chunk) for want, chunk in chunks.items()}
    return _assemble(header, entries, [chunks[w] for w in plan(header, entries)], where)


def _counted_at_base(want: Want, chunk: _Chunk) -> _Chunk:
    """A directory at the front is among the bytes of level 0."""
    if want.kind is not Kind.DIRECTORY:
        return chunk
    return chunk._replace(parts=tuple(replace(part, level=0) for part in chunk.parts))


def _assemble(
    header: Header, entries: tuple[LevelEntry, ...], chunks: list[_Chunk], where: str
) -> tuple[bytes, SizeAccount]:
    """Positions, index and all bytes."""
    offset = layout.index_bytes(len(entries), len(chunks))
    placed: list[ChunkEntry] = []
    ends: list[int] = []
    shared = first_shared(plan(header, entries))
    for number, chunk in enumerate(chunks):
        if number == shared:
            header = header._replace(head=offset)
        placed.append(chunk.entry._replace(offset=offset))
        offset += len(chunk.body)
        # Blocks are the last chunk of each level, so a prefix that ends here is a valid file.
        if chunk.entry.kind == Kind.BLOCKS:
            ends.append(offset)
    check_ranges(header, "header", where)
    entries = tuple(e._replace(end=end) for e, end in zip(entries, ends, strict=True))
    index = Index(header, entries, tuple(placed))
    # By the reader's own rules: what it would refuse is never written.
    check_chunks(index, where)
    head = pack_index(index)
    data = b"".join([head, *(chunk.body for chunk in chunks)])
    parts = tuple(part for chunk in chunks for part in chunk.parts)
    return data, SizeAccount(len(head), parts, tuple(ends))


@dataclass(frozen=True)
class _Source:
    """The chunks of a level set, in the order of the plan."""

    levels: LevelSet
    header: Header
    entries: tuple[LevelEntry, ...]
    pieces: list[LevelPieces]
    plan: CodingPlan
    where: str
    pages: list[LevelPages] | None

    def chunk(self, want: Want) -> _Chunk:
        """One chunk, without its position."""
        level = self.levels.levels[want.level]
        match want.kind:
            case Kind.MANIFEST:
                quality = [level.quality for level in self.levels.levels]
                text = manifest_text(self.levels.meta, quality, len(quality), self.where)
                return _chunk(want, len(text), text, values=len(text))
            case Kind.DIRECTORY:
                holder = self.pages[want.level] if self.pages else self.pieces[want.level]
                records = holder.records
                raw = pack_directory(records)
                return _chunk(want, len(records), raw, values=len(records))
            case Kind.NETWORKS:
                return self._networks(want, self.levels.own_networks(want.level))
            case Kind.CODEBOOK:
                return self._array(want, level.codebook, self.plan.codebook)
            case Kind.GRID:
                grid = self.levels.shared.grids[want.part]
                chunk = self._array(want, grid, self.plan.grid)
                resolution = int(self.levels.shared.grid_resolutions[want.part])
                return chunk._replace(entry=chunk.entry._replace(resolution=resolution))
            case _:
                pages = self.pages[want.level] if self.pages else None
                return _blocks(want, self.pieces[want.level], pages)

    def _networks(self, want: Want, weights: dict[str, Float32]) -> _Chunk:
        coding, least = self.plan.networks[:2]
        shapes = {name: weight.shape for name, weight in weights.items()}
        try:
            raw = encode_networks(coding, weights, least)
        except NotFiniteError as error:
            raise self._not_finite(want, error) from error
        # The error is that of the values a reader gets.
        found = decode_networks(coding, raw, shapes)
        error = max(_error(weights[name], found[name]) for name in weights)
        count = sum(weight.size for weight in weights.values())
        return _chunk(want, count, raw, values=count, coding=coding, error=error)

    def _array(self, want: Want, array: Float32, coder: Quantizer) -> _Chunk:
        try:
            raw = encode_values(coder.coding, array, coder.least)
        except NotFiniteError as error:
            raise self._not_finite(want, error) from error
        rows, columns = array.shape
        error = _error(array, decode_values(coder.coding, raw, rows, columns))
        return _chunk(want, rows, raw, values=array.size, coding=coder.coding, error=error)

    def _not_finite(self, want: Want, error: NotFiniteError) -> ValueRangeError:
        field = name_of(_chunk(want, 1, b"", values=0).entry)
        return ValueRangeError(self.where, field, found=error, expected="finite values")


def _chunk(
    want: Want,
    rows: int,
    raw: bytes,
    *,
    values: int,
    coding: CodingId = CodingId.FLOAT,
    error: float = 0.0,
) -> _Chunk:
    stored = deflate(raw)[0]
    entry = ChunkEntry(
        kind=int(want.kind),
        level=want.level,
        coding=int(coding),
        part=want.part,
        rows=rows,
        offset=0,
        stored=len(stored),
        raw=len(raw),
        crc=zlib.crc32(stored),
        resolution=0,
    )
    coded = coding.label if want.kind in (Kind.NETWORKS, Kind.CODEBOOK, Kind.GRID) else ""
    part = PartSize(want.level, want.kind.label, coded, len(stored), len(raw), values, error)
    return _Chunk(entry, stored, (part,))


def _blocks(want: Want, pieces: LevelPieces, pages: LevelPages | None) -> _Chunk:
    raw = int(pieces.records["raw"].astype(np.int64).sum())
    # Each block is deflated alone, with its checksum in the directory; the chunk has neither.
    body, parts = b"".join(pieces.bodies), pieces.parts
    if pages is not None:
        own, count = pieces.records.nbytes, len(pieces.records)
        stored = sum(len(page) for page in pages.bodies)
        # A page stands right before its blocks, so that one request can bring both.
        body, raw = pages.interleave(pieces.bodies), raw + own
        parts = (PartSize(want.level, "pages", "", stored, own, count, 0.0), *parts)
    entry = ChunkEntry(
        kind=int(Kind.BLOCKS),
        level=want.level,
        coding=0,
        part=0,
        rows=len(pieces.records),
        offset=0,
        stored=len(body),
        raw=raw,
        crc=0,
        resolution=0,
    )
    return _Chunk(entry, body, parts)


def _error(given: Float32, found: Float32) -> float:
    return float(np.abs(given.astype(np.float64) - found).max(initial=0))


def _required(levels: LevelSet) -> int:
    """Bits of what rows are; those of how they are stored come later."""
    splats = layout.SPLATS if levels.shared.degree is not None else 0
    return splats | (layout.STAND_INS if levels.shared.stand_ins else 0)


def _header(levels: LevelSet, where: str) -> Header:
    frame, shared, last = levels.frame, levels.shared, levels.levels[-1]
    header = Header(
        magic=layout.MAGIC,
        version=layout.VERSION,
        required=_required(levels),
        levels=len(levels.levels),
        chunks=4,
        slots=shared.slots,
        features=int(shared.grids[0].shape[1]) if last.grids else shared.harmonics,
        residual=int(shared.residual.shape[1]),
        contract=int(levels.frame.contract),
        front=1,
        stand_ins=shared.stand_ins,
        crc=0,
        head=0,
        voxel=float(frame.voxel),
        center_x=float(frame.center[0]),
        center_y=float(frame.center[1]),
        center_z=float(frame.center[2]),
        radius=float(frame.radius),
        extent=float(frame.extent),
    )
    check_ranges(header, "header", where)
    return header


def _entry(levels: LevelSet, number: int, plan: CodingPlan, blocks: int, where: str) -> LevelEntry:
    level = levels.levels[number]
    fused = "fuse_b1" in level.networks
    if fused and not len(level.networks["fuse_b1"]):
        field = f"level {number}: fuse_hidden"
        raise LayoutError(where, field, found=0, expected="at least 1")
    return LevelEntry(
        # A place holder within range; `_assemble` fills in the offset.
        end=1,
        anchors=level.anchors,
        live=level.live,
        blocks=blocks,
        grids=level.grids,
        head_hidden=len(level.networks.get("opacity_b1", ())),
        fuse_hidden=len(level.networks["fuse_b1"]) if fused else 0,
        fuse_out=len(level.networks["fuse_b2"]) if fused else 0,
        codebook_rows=int(level.codebook.shape[0]),
        codebook_columns=int(level.codebook.shape[1]),
        log_scales=int(plan.log_scales.coding),
        residual=int(plan.residual.coding),
        offsets=int(plan.offsets.coding) if levels.shared.degree is None else 0,
        inherits=int(levels.inherits(number)),
        gain_x=float(level.gain[0]),
        gain_y=float(level.gain[1]),
        gain_z=float(level.gain[2]),
    )


def publish(data: bytes, path: Path) -> None:
    """`files.publish` where the disk has room; on any failure nothing is left.

    Raises:
        SpaceError: the disk has no room for it.
        InputError: the path can not be written.
    """
    try:
        full = shutil.disk_usage(path.parent).free < len(data)
    except OSError as error:
        raise files.write_error(path, error) from error
    if full:
        raise _no_space(path, len(data))
    files.publish(path, data)


def _no_space(path: Path, length: int) -> SpaceError:
    free = shutil.disk_usage(path.parent).free
    advice = "free some space or choose another folder"
    return SpaceError(path, "disk", found=f"{free} bytes", expected=f"{length}", advice=advice)
