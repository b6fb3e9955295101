"""Decoded pieces of a file that a client holds, chunk by chunk and block by block, and its levels.

It is the one decoder: a whole file, a prefix and a client that fetches single blocks all go through
it, so they agree bit for bit.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.blocks import Block, decode_block, scales_of, shape_of
from gsynopsis.container.codecs import Bytes, CodecError, NotFiniteError
from gsynopsis.container.directory import Directory, checked_bytes, checked_span, parse_directory
from gsynopsis.container.index import Index, columns_of, name_of, own_shapes_of, parse_index
from gsynopsis.container.layout import ChunkEntry, CodingId, Kind
from gsynopsis.container.manifest import read_manifest
from gsynopsis.container.pages import (
    PageTable,
    parse_page,
    parse_pages,
    put_page,
    unknown_blocks,
)
from gsynopsis.container.values import decode_networks, decode_values
from gsynopsis.errors import LayoutError, TruncatedError, ValueRangeError
from gsynopsis.records import HARMONICS, Float32, Frame, Level, LevelSet, Shared


class Spans(Protocol):
    """Bytes that are had slice by slice, as those of an open file."""

    def __len__(self) -> int: ...

    def __getitem__(self, span: slice, /) -> Bytes:
        """The bytes of a range."""
        ...


Held = Mapping[int, Collection[int]]
"""Numbers of the blocks that are there, by level."""


@dataclass(frozen=True)
class Partial:
    """The renderable part of a file of which only some blocks are held.

    Attributes:
        levels: Complete levels, then levels that are complete only where blocks are held; anchors
            and slots of other regions are those of the level before.
        region: Level whose networks and codebook render an anchor of `levels`, uint8 [N].
    """

    levels: LevelSet
    region: NDArray[np.uint8]


class Assembler:
    """A client's state: the index, then chunks and blocks in any order their parents allow.

    It holds decoded pieces, never the bytes; what `level_set` returns is a copy that the caller
    owns. After an error the state is as before the call, so a piece may be fetched again.

    Attributes:
        index: Header and tables: where each chunk lies.
        directories: By level, position and contents of each block; as far as given. In pages
            the records of a block are 0 until its page is there.
        pages: By level the page table, if directories are in pages; as far as given.
        meta: Notes of the manifest, empty until its chunk, the first, is there.
        quality: Figures of the manifest for each level of the whole file, empty until then.
    """

    def __init__(self, head: Bytes | Index, source: str) -> None:
        """Start from the first bytes of a file, at least header and tables.

        Args:
            head: 16 KiB are always enough; bytes after the tables are ignored. Or what
                `parse_index` made of them.
            source: What messages call the file.

        Raises:
            FormatError: header or tables break a promise of docs/format.md.
        """
        self.index = head if isinstance(head, Index) else parse_index(head, source)
        self.directories: dict[int, Directory] = {}
        self.pages: dict[int, PageTable] = {}
        self._pages_held: dict[int, set[int]] = {}
        self.meta: dict[str, str] = {}
        self.quality: list[dict[str, float]] = []
        self._source = source
        self._networks: dict[int, dict[str, Float32]] = {}
        self._codebooks: dict[int, Float32] = {}
        self._grids: dict[int, Float32] = {}
        self._blocks: dict[int, dict[int, Block]] = {}
        self._masks: dict[int, NDArray[np.bool_]] = {}

    @property
    def levels_ready(self) -> int:
        """Number of complete levels, from the coarsest on."""
        count = 0
        while count < len(self.index.levels) and self._complete(count):
            count += 1
        return count

    def has_shared(self, level: int) -> bool:
        """True if networks, codebook and grids of a level are held; with splats, the codebook."""
        entry = self.index.levels[level]
        if self.index.splats:
            return not entry.codebook_rows or self.index.owner_of(level) in self._codebooks
        codebook = level in self._codebooks or not entry.codebook_rows * entry.codebook_columns
        grids = all(part in self._grids for part in range(entry.grids))
        networks = {level, self.index.owner_of(level)} <= self._networks.keys()
        return networks and codebook and grids

    def has_block(self, level: int, block: int) -> bool:
        """True if a block is held."""
        return block in self._blocks.get(level, {})

    def has_record(self, level: int, block: int) -> bool:
        """True if the directory entry of a block is held."""
        if level not in self.directories or not 0 <= block < len(self.directories[level]):
            return False
        return not self.index.paged or self.has_page(level, self.pages[level].page_of(block))

    def has_page(self, level: int, page: int) -> bool:
        """True if a page of a directory is held."""
        return page in self._pages_held.get(level, ())

    def held_pages(self, level: int) -> NDArray[np.bool_]:
        """Mask of the held pages of a level, [P]."""
        held = np.zeros(len(self.pages[level]), np.bool_)
        held[list(self._pages_held.get(level, ()))] = True
        return held

    def add(self, chunk: ChunkEntry, stored: Bytes) -> None:
        """Take the bytes of a chunk of the index, other than blocks, in any order.

        Raises:
            FormatError: they are not what the tables promise, or a directory comes before that of
                the level before.
        """
        where = name_of(chunk)
        if chunk.kind == Kind.DIRECTORY:
            self._add_directory(chunk, stored)
            return
        raw = checked_bytes(chunk, stored, where, self._source)
        coding, level = CodingId(chunk.coding), chunk.level
        try:
            match Kind(chunk.kind):
                case Kind.MANIFEST:
                    count = len(self.index.levels)
                    self.meta, self.quality = read_manifest(raw, count, self._source)
                case Kind.NETWORKS:
                    shapes = own_shapes_of(self.index.header, self.index.levels[level])
                    self._networks[level] = decode_networks(coding, raw, shapes)
                case Kind.CODEBOOK | Kind.GRID:
                    values = decode_values(coding, raw, chunk.rows, columns_of(self.index, chunk))
                    if chunk.kind == Kind.GRID:
                        self._grids[chunk.part] = values
                    else:
                        self._codebooks[level] = values
                case _:
                    raise LayoutError(self._source, where, found="blocks", expected="add_block")
        except NotFiniteError as error:
            expected = "finite values"
            raise ValueRangeError(self._source, where, found=error, expected=expected) from error

    def add_block(self, level: int, block: int, stored: Bytes) -> None:
        """Take the bytes of a block, whose directory and parent block are there.

        Raises:
            FormatError: they are not what the directory promises.
            LayoutError: the block's parent is not there.
        """
        where = f"level {level} block {block}"
        if not self.has_record(level, block):
            raise LayoutError(self._source, where, found="no record of it in a directory")
        directory = self.directories[level]
        record = directory.records[block]
        if level and not self.has_block(level - 1, int(record["parent"])):
            expected = f"level {level - 1} block {record['parent']} first"
            raise LayoutError(self._source, where, expected=expected)
        sizes = (int(record["stored"]), int(record["raw"]), int(record["crc"]))
        raw = checked_span(stored, sizes, where, self._source)
        try:
            found = decode_block(raw, shape_of(self.index, level, record))
        except NotFiniteError as error:
            expected = "finite values"
            raise ValueRangeError(self._source, where, found=error, expected=expected) from error
        except CodecError as error:
            raise LayoutError(self._source, where, found=error) from error
        self._check_values(level, record, found, where)
        self._place(directory, block, found, where)
        self._blocks.setdefault(level, {})[block] = found

    def add_page(self, level: int, page: int, stored: Bytes) -> None:
        """Take the bytes of a page, whose table and the page of the level before are there.

        Raises:
            FormatError: they are not what the table promises.
            LayoutError: the page that its blocks divide is not there.
        """
        where = f"level {level} page {page}"
        if level not in self.pages or not 0 <= page < len(self.pages[level]):
            raise LayoutError(self._source, where, found="no record of it in a page table")
        table, parents = self.pages[level], None
        if level:
            parent = int(table.records["parent"][page])
            if not self.has_page(level - 1, parent):
                expected = f"level {level - 1} page {parent} first"
                raise LayoutError(self._source, where, expected=expected)
            divided = table.parents_of(page)
            parents = self.directories[level - 1].records[divided.start : divided.stop]
        found = parse_page(self.index, table, page, stored, self._source, parents)
        put_page(self.directories[level], found, int(table.first[page]))
        self._pages_held.setdefault(level, set()).add(page)

    def add_level(self, data: Bytes | Spans) -> None:
        """Take all that the next level needs out of the bytes of the file from its beginning.

        Args:
            data: The file, or a prefix at least to the end of that level; slices are taken of it.

        Raises:
            FormatError: as `add` and `add_block`.
        """
        view = memoryview(data) if isinstance(data, bytes | bytearray) else data
        level = self.levels_ready
        if level == len(self.index.levels):
            raise LayoutError(self._source, found="a level after the last")
        end = self.index.levels[level].end
        if len(view) < end:
            found = f"{len(view)} bytes"
            raise TruncatedError(self._source, f"level {level}", found=found, expected=f"{end}")
        start = self.index.levels[level - 1].end if level else 0
        for chunk in self.index.chunks:
            if not start <= chunk.offset < end and chunk.stored:
                continue
            if chunk.kind != Kind.BLOCKS:
                self.add(chunk, view[chunk.offset : chunk.offset + chunk.stored])
            elif chunk.level == level:
                pages = self.pages.get(level)
                for page in range(len(pages) if pages else 1):
                    blocks = range(chunk.rows)
                    if pages:
                        first, last = pages.span_of(page)
                        self.add_page(level, page, view[first:last])
                        blocks = pages.blocks_of(page)
                    for block in blocks:
                        first, last = self.directories[level].span_of(block)
                        self.add_block(level, block, view[first:last])

    def level_set(self) -> LevelSet:
        """All complete levels.

        Raises:
            LayoutError: no level is complete.
        """
        return self._level_set(self._ready_masks(), self._blocks, None)

    def partial(self, blocks: Held | None = None) -> Partial:
        """All that can be rendered: complete levels, and blocks of finer ones with shared parts.

        Args:
            blocks: As if of the levels after the first only these blocks were there, by level;
                None for all that are.

        Raises:
            LayoutError: no level is complete.
        """
        masks = self._ready_masks()
        held: Held = self._blocks if blocks is None else {0: self._blocks[0], **blocks}
        entries = self.index.levels[: len(masks)]
        whole = [len(held.get(k, ())) == entry.blocks for k, entry in enumerate(entries)]
        ready = (*whole, False).index(False)
        masks = masks[:ready]
        region = np.full(len(masks[-1]), ready - 1, np.uint8)
        for level in range(ready, len(self.index.levels)):
            if not self.has_shared(level) or not held.get(level):
                break
            mask = np.zeros((self.index.levels[level].anchors, masks[-1].shape[1]), np.bool_)
            mask[: len(masks[-1])] = masks[-1]
            region = np.append(region, np.full(len(mask) - len(region), level, np.uint8))
            for block in held[level]:
                rows = self.directories[level].rows_of(block)
                mask[rows], region[rows] = self._masks[level][rows], level
            masks.append(mask)
        keep = np.flatnonzero(masks[-1].any(axis=1))
        return Partial(self._level_set(masks, held, keep), region[keep])

    def _ready_masks(self) -> list[NDArray[np.bool_]]:
        """Masks of the complete levels, at least one."""
        ready = self.levels_ready
        if not ready:
            raise LayoutError(self._source, found="no complete level")
        return [self._masks[k] for k in range(ready)]

    def _level_set(
        self, masks: list[NDArray[np.bool_]], held: Held, keep: NDArray[np.int64] | None
    ) -> LevelSet:
        """The levels of given masks; of the last one's rows, only those to keep."""
        shared = self._shared(len(masks), held)
        if keep is not None:
            shared = shared.of_rows(keep)
            masks = [mask[keep[keep < len(mask)]] for mask in masks]
        levels = tuple(self._level(number, mask) for number, mask in enumerate(masks))
        try:
            return LevelSet(self._frame(), shared, levels, dict(self.meta))
        except ValueError as error:
            raise LayoutError(self._source, found=error) from error

    def _add_directory(self, chunk: ChunkEntry, stored: Bytes) -> None:
        level = chunk.level
        if level and level - 1 not in self.directories:
            expected = f"level {level - 1} directory first"
            raise LayoutError(self._source, name_of(chunk), expected=expected)
        if self.index.paged:
            above = self.pages.get(level - 1)
            self.pages[level] = parse_pages(self.index, level, stored, self._source, above)
            self.directories[level] = unknown_blocks(self.index, level)
            return
        parent = self.directories[level - 1] if level else None
        self.directories[level] = parse_directory(self.index, level, stored, self._source, parent)

    def _check_values(self, level: int, record: np.void, block: Block, where: str) -> None:
        """Codes and coordinates lie in their ranges."""
        levels = self.index.levels[level : level + 1 if self.index.splats else None]
        entries = min(entry.codebook_rows for entry in levels)
        if block.codes.size and (most := int(block.codes.max())) >= entries:
            expected = f"a code below {entries}"
            raise ValueRangeError(self._source, where, found=most, expected=expected)
        for axis, column in zip("xyz", block.lattice.T, strict=True):
            low, high = int(record[f"low_{axis}"]), int(record[f"high_{axis}"])
            if len(column) and (column.min() < low or column.max() > high):
                found = f"{axis} from {column.min()} to {column.max()}"
                expected = f"{low} to {high}"
                raise ValueRangeError(self._source, where, found=found, expected=expected)

    def _place(self, directory: Directory, block: int, found: Block, where: str) -> None:
        """Put a block's live slots into its level's mask."""
        level, slots = directory.level, self.index.header.slots
        rows = directory.rows_of(block)
        mask = np.zeros((len(rows), slots), np.bool_)
        if level:
            old = len(rows) - len(found.lattice)
            mask[:old] = self._masks[level - 1][rows[:old]]
        if (shown := int(mask.sum())) != (before := mask.size - found.mask.size):
            live = f"{shown} live slots at level {level - 1}"
            raise LayoutError(
                self._source, where, found=live, expected=f"{before} as in its record"
            )
        mask[~mask] = found.mask
        some = mask.any(axis=1)
        if not some.all():
            anchor = int(rows[int(np.argmin(some))])
            raise LayoutError(self._source, where, found=f"anchor {anchor} without a live slot")
        if level not in self._masks:
            self._masks[level] = np.zeros((self.index.levels[level].anchors, slots), np.bool_)
        self._masks[level][rows] = mask

    def _complete(self, level: int) -> bool:
        held = len(self._blocks.get(level, {}))
        return self.has_shared(level) and held == self.index.levels[level].blocks

    def _frame(self) -> Frame:
        header = self.index.header
        center = np.array([header.center_x, header.center_y, header.center_z], np.float64)
        return Frame(header.voxel, center, header.radius, bool(header.contract), header.extent)

    def _shared(self, levels: int, held: Held) -> Shared:
        """Arrays of the anchors up to a level; rows of blocks that are not held are zero."""
        header, entry = self.index.header, self.index.levels[levels - 1]
        n = entry.anchors
        coded: tuple[int, ...] = (n if entry.codebook_rows else 0,)
        if self.index.splats:
            coded = (n, max(self.index.codes_of(k) for k in range(levels)))
        shared = Shared(
            lattice=np.zeros((n, 3), np.int32),
            log_scales=np.zeros((n, scales_of(self.index.splats)), np.float32),
            offsets=np.zeros((n, header.slots, 0 if self.index.splats else 3), np.float32),
            codes=np.zeros(coded, np.uint8),
            residual=np.zeros((n, header.residual), np.float32),
            grids=tuple(self._grids[part].copy() for part in range(entry.grids)),
            grid_resolutions=tuple(c.resolution for c in self.index.chunks if c.kind == Kind.GRID)[
                : entry.grids
            ],
            degree=HARMONICS.index(header.features) if self.index.splats else None,
            stand_ins=header.stand_ins if header.stand_ins < levels else 0,
        )
        for level in range(levels):
            for number in held[level]:
                block = self._blocks[level][number]
                self._fill(shared, self.directories[level], number, block)
        return shared

    def _fill(self, shared: Shared, directory: Directory, number: int, block: Block) -> None:
        """The rows and slots that a block brings."""
        start, end = directory.fresh_of(number)
        shared.lattice[start:end] = block.lattice
        shared.log_scales[start:end] = block.log_scales
        shared.residual[start:end] = block.residual
        if shared.codes.ndim > 1:
            shared.codes[start:end, : block.codes.shape[1]] = block.codes
        elif len(shared.codes):
            shared.codes[start:end] = block.codes
        if not len(block.offsets):
            return
        level, slots = directory.level, self.index.header.slots
        rows = directory.rows_of(number)
        new = self._masks[level][rows]
        if level:
            old = len(rows) - len(block.lattice)
            new[:old] &= ~self._masks[level - 1][rows[:old]]
        chosen = np.flatnonzero(new)
        flat = rows[chosen // slots] * slots + chosen % slots
        shared.offsets.reshape(-1, 3)[flat] = block.offsets

    def _level(self, number: int, mask: NDArray[np.bool_]) -> Level:
        entry = self.index.levels[number]
        # The order of names is the owner's: biases take the places of its own.
        owner = self.index.owner_of(number)
        networks: dict[str, Float32] = {}
        if not self.index.splats:
            networks = self._networks[owner] | self._networks[number]
        codebook = self._codebooks.get(owner if self.index.splats else number)
        if codebook is None:
            codebook = np.zeros((entry.codebook_rows, entry.codebook_columns), np.float32)
        return Level(
            mask=mask.copy(),
            grids=entry.grids,
            codebook=codebook.copy(),
            networks={name: weight.copy() for name, weight in networks.items()},
            gain=np.array([entry.gain_x, entry.gain_y, entry.gain_z], np.float32),
            quality=dict(self.quality[number]) if self.quality else {},
        )
