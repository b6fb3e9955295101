"""Directories in pages: the same scene, any page alone, and nothing false accepted."""

import itertools
import tracemalloc
import zlib
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.robust.forge import index_of
from gsynopsis.container import (
    annotated,
    check_file,
    cut_file,
    decode,
    describe,
    layout,
    split_file,
)
from gsynopsis.container.assembler import Assembler
from gsynopsis.container.codecs import deflate, inflate
from gsynopsis.container.directory import pack_directory, record_type, unpack_records
from gsynopsis.container.encode_level import LevelPieces
from gsynopsis.container.index import Index, pack_index
from gsynopsis.container.layout import BlockEntry, Kind, PageEntry
from gsynopsis.container.pages import cut_pages
from gsynopsis.container.writer import encode_with_account, write_gsyn
from gsynopsis.errors import FormatError, LayoutError, ValueRangeError
from gsynopsis.records import LevelSet
from tests.container.plain_reader import read_plain
from tests.level_sets import SPLATS, Shape, assert_same, make_level_set
from tests.memory import TRACED, at_most

SHAPE = Shape(anchors=(60, 130, 260), slots=3, grids=(1, 1, 2))
LEVELS = make_level_set(np.random.default_rng(4), SHAPE)
PLAIN = make_level_set(np.random.default_rng(5), replace(SPLATS, anchors=(0, 70, 200)))
DATA, ACCOUNT = encode_with_account(LEVELS, block=8, page=4)
SMALL = encode_with_account(
    make_level_set(np.random.default_rng(4), replace(SPLATS, anchors=(12, 25))), block=4, page=1
)[0]
WHOLE = encode_with_account(LEVELS, block=8)[0]
U32 = 2**32 - 1
MIB = 1 << 20


@dataclass
class Taken:
    """A file in pages; `data` puts it together again with checksums and lengths right."""

    index: Index
    bodies: list[bytes]
    tables: dict[int, np.ndarray]
    pages: dict[int, list[bytes]]
    blocks: dict[int, list[bytes]]

    def data(self) -> bytes:
        """The file; sizes of pages, not of their blocks, follow."""
        chunks, levels = list(self.index.chunks), list(self.index.levels)
        bodies, head, raws = list(self.bodies), 0, dict[int, int]()
        for level, table in self.tables.items():
            stored = [deflate(raw)[0] for raw in self.pages[level]]
            table["stored"] = [len(page) for page in stored]
            table["crc"] = [zlib.crc32(page) for page in stored]
            interleave = zip(stored, self.blocks[level], strict=True)
            bodies[self.number(Kind.DIRECTORY, level)] = deflate(pack_directory(table))[0]
            bodies[self.number(Kind.BLOCKS, level)] = b"".join(itertools.chain(*interleave))
            raws[level] = sum(len(raw) for raw in self.pages[level])
        offset = self.index.length
        for i, (chunk, body) in enumerate(zip(chunks, bodies, strict=True)):
            crc = 0 if chunk.kind == Kind.BLOCKS else zlib.crc32(body)
            chunks[i] = chunk._replace(offset=offset, stored=len(body), crc=crc)
            if not head and chunk.kind not in (Kind.MANIFEST, Kind.DIRECTORY):
                head = offset
            offset += len(body)
            if chunk.kind == Kind.BLOCKS:
                levels[chunk.level] = levels[chunk.level]._replace(end=offset)
        header = self.index.header._replace(head=head)
        return pack_index(Index(header, tuple(levels), tuple(chunks))) + b"".join(bodies)

    def number(self, kind: Kind, level: int) -> int:
        """Of a chunk."""
        return self.index.chunks.index(self.index.chunk_of(level, kind))

    def records(self, level: int, page: int) -> np.ndarray:
        """Of the blocks of a page; a copy."""
        return unpack_records(self.pages[level][page], record_type(level)).copy()

    def put(self, level: int, page: int, records: np.ndarray) -> None:
        """Other records."""
        self.pages[level][page] = pack_directory(records)


def taken(data: bytes) -> Taken:
    """A whole file in pieces."""
    index = index_of(data)
    found = Taken(index, [data[c.offset : c.offset + c.stored] for c in index.chunks], {}, {}, {})
    for level in range(len(index.levels)):
        chunk = index.chunk_of(level, Kind.DIRECTORY)
        raw = inflate(data[chunk.offset : chunk.offset + chunk.stored], chunk.raw)
        table = unpack_records(raw, record_type(level, PageEntry)).copy()
        at = index.chunk_of(level, Kind.BLOCKS).offset
        found.tables[level], found.pages[level], found.blocks[level] = table, [], []
        size = layout.block_entry_bytes(level)
        for stored, count, body in table[["stored", "blocks", "body"]].tolist():
            found.pages[level].append(bytes(inflate(data[at : at + stored], count * size)))
            found.blocks[level].append(data[at + stored : at + stored + body])
            at += stored + body
    return found


def spans(data: bytes) -> list[tuple[int, int]]:
    """Where page tables and pages stand in a file."""
    index, found = index_of(data), list[tuple[int, int]]()
    pieces = taken(data)
    for level, table in pieces.tables.items():
        chunk = index.chunk_of(level, Kind.DIRECTORY)
        found.append((chunk.offset, chunk.offset + chunk.stored))
        at = index.chunk_of(level, Kind.BLOCKS).offset
        for stored, body in table[["stored", "body"]].tolist():
            found.append((at, at + stored))
            at += stored + body
    return found


@pytest.mark.parametrize("levels", [LEVELS, PLAIN], ids=["anchors", "splats"])
@pytest.mark.parametrize("front", [True, False])
def test_pages_hold_the_scene_of_a_whole_directory(
    levels: LevelSet, front: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not front:
        most = Assembler(encode_with_account(levels, block=8, page=4)[0], "x").index.header.head
        monkeypatch.setattr(layout, "INDEX_BYTES_MAX", most - 1)
    data = encode_with_account(levels, block=8, page=4)[0]
    assert index_of(data).header.required & layout.PAGES
    assert index_of(data).header.front == front
    whole = decode(encode_with_account(levels, block=8)[0], "whole")
    assert_same(decode(data, "paged"), whole)
    for number, level in enumerate(index_of(data).levels):
        assert decode(data[: level.end], "prefix").levels[-1].anchors == level.anchors
        assert (decode(data, "x", number).levels[-1].mask == whole.levels[number].mask).all()


def test_a_file_of_few_blocks_has_no_pages() -> None:
    assert not index_of(WHOLE).header.required & layout.PAGES
    assert encode_with_account(LEVELS, block=8, page=10**6)[0] == WHOLE


def test_a_reader_from_the_page_alone_agrees() -> None:
    for levels in (LEVELS, PLAIN):
        paged = read_plain(encode_with_account(levels, block=8, page=4)[0])
        whole = read_plain(encode_with_account(levels, block=8)[0])
        assert paged["head"].pop("paged") and not whole["head"].pop("paged")
        for part in (*paged["levels"], *whole["levels"]):
            part.pop("end")
        assert paged == whole


def test_pages_divide_pages_and_part_no_family() -> None:
    pieces = taken(DATA)
    for level, table in pieces.tables.items():
        links = [set(pieces.records(level, page)["parent"].tolist()) for page in range(len(table))]
        assert len(table) > 2
        if level:
            assert not any(a & b for a, b in itertools.pairwise(links))
            ends = np.cumsum(pieces.tables[level - 1]["blocks"])
            pages = [set(np.searchsorted(ends, list(link), "right").tolist()) for link in links]
            assert pages == [{int(parent)} for parent in table["parent"]]
        for count, link in zip(table["blocks"], links, strict=True):
            assert count <= 4 or len(link) == 1


def test_any_page_is_of_use_without_the_others() -> None:
    client, whole = Assembler(DATA, "x"), Assembler(DATA, "x")
    for chunk in client.index.chunks:
        if chunk.kind != Kind.BLOCKS:
            client.add(chunk, DATA[chunk.offset : chunk.offset + chunk.stored])
    for _ in client.index.levels:
        whole.add_level(DATA)
    page = len(client.pages[2]) - 2
    upper = int(client.pages[2].records["parent"][page])
    with pytest.raises(LayoutError, match=f"level 1 page {upper} first"):
        client.add_page(2, page, b"")
    line = [(2, page), (1, upper), (0, int(client.pages[1].records["parent"][upper]))]
    block = client.pages[2].blocks_of(page)[1]
    with pytest.raises(LayoutError, match="no record of it"):
        client.add_block(2, block, b"")
    for level, number in reversed(line):
        first, last = client.pages[level].span_of(number)
        client.add_page(level, number, DATA[first:last])
    for level, number in line:
        for each in client.pages[level].blocks_of(number):
            assert client.has_record(level, each)
            assert client.directories[level].span_of(each) == whole.directories[level].span_of(each)
            found = client.directories[level].rows_of(each)
            assert (found == whole.directories[level].rows_of(each)).all()
    assert not client.has_record(2, 0)
    parent = int(client.directories[2].records["parent"][block])
    above = int(client.directories[1].records["parent"][parent])
    for level, each in ((0, above), (1, parent), (2, block)):
        first, last = client.directories[level].span_of(each)
        client.add_block(level, each, DATA[first:last])
    with pytest.raises(LayoutError, match="no record of it in a page table"):
        client.add_page(2, len(client.pages[2]), b"")


def test_edits_and_reports_know_pages(tmp_path: Path) -> None:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(DATA)
    assert_same(check_file(path), decode(WHOLE, "whole"))
    end = cut_file(path, 1, tmp_path / "cut.gsyn")
    assert check_file(tmp_path / "cut.gsyn").levels[-1].anchors == SHAPE.anchors[1]
    pieces = split_file(path, tmp_path)
    assert b"".join(piece.path.read_bytes() for piece in pieces) == DATA
    assert pieces[1].stop == end
    changed = annotated(DATA, {"licence": "CC0", "note": "n" * 999}, None, "x")
    assert decode(changed, "x").meta["licence"] == "CC0"
    info = describe(path)
    assert sum(part.stored for level in info.levels for part in level.parts) == (
        info.bytes - info.index_bytes
    )
    assert ACCOUNT.total == info.bytes
    said = {(v.level, p.kind): p.stored for v in info.levels for p in v.parts}
    for part in ACCOUNT.parts:
        if part.kind == "pages":
            assert said[part.level, "pages"] == part.stored > 0


def test_every_changed_byte_of_tables_and_pages_is_refused() -> None:
    assert len(spans(SMALL)) > 8
    for start, stop in spans(SMALL):
        for at in range(start, stop):
            changed = bytearray(SMALL)
            changed[at] ^= 1 << at % 8
            with pytest.raises(FormatError):
                decode(bytes(changed), "x")


TABLE_BREAKS: dict[str, tuple[type[FormatError], list[float]]] = {
    "parent": (LayoutError, [7, 65535, U32]),
    "blocks": (LayoutError, [0, 1, 9, 65536, U32]),
    "parents": (LayoutError, [0, 9, 65536, U32]),
    "live": (LayoutError, [0, 1, U32]),
    "before": (LayoutError, [1, 999, U32]),
    "low_x": (LayoutError, [2**31 - 1]),
    "low_y": (LayoutError, [2**31 - 1]),
    "low_z": (LayoutError, [2**31 - 1]),
    "high_x": (LayoutError, [-(2**31)]),
    "high_y": (LayoutError, [-(2**31)]),
    "high_z": (LayoutError, [-(2**31)]),
    "reach": (ValueRangeError, [-1.0, np.nan, np.inf, 0.0]),
    "body": (LayoutError, [0, 1, 2**53, 2**63, 2**64 - 1]),
    "raw": (LayoutError, [0, 1, 2**53, 2**63, 2**64 - 1]),
}


def test_what_is_stored_of_a_page_is_what_its_table_says() -> None:
    assert {*TABLE_BREAKS, "stored", "crc"} == set(PageEntry._fields)
    for name in ("stored", "crc"):
        for value in (0, 1, 77, U32):
            pieces = taken(DATA)
            number = pieces.number(Kind.DIRECTORY, 1)
            pieces.tables[1][name][1] = value
            body = deflate(pack_directory(pieces.tables[1]))[0]
            with pytest.raises(FormatError, match="level 1"):
                decode(_with_table(DATA, number, body), "x")


def _with_table(data: bytes, number: int, body: bytes) -> bytes:
    """Another page table, as it stands, checksums and all that is behind it moved."""
    index = index_of(data)
    old = index.chunks[number]
    by = len(body) - old.stored
    chunks = [
        c._replace(offset=c.offset + (by if i > number else 0)) for i, c in enumerate(index.chunks)
    ]
    chunks[number] = old._replace(stored=len(body), crc=zlib.crc32(body))
    levels = tuple(level._replace(end=level.end + by) for level in index.levels)
    header = index.header._replace(head=index.header.head + by)
    moved = data[index.length : old.offset] + body + data[old.offset + old.stored :]
    return pack_index(Index(header, levels, tuple(chunks))) + moved


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize("name", TABLE_BREAKS)
def test_a_broken_field_of_a_table_is_refused(name: str, level: int) -> None:
    expected, values = TABLE_BREAKS[name]
    for value in values:
        pieces = taken(DATA)
        if pieces.tables[level][name][1] == value:
            continue
        pieces.tables[level][name][1] = value
        with pytest.raises(expected) as caught:
            decode(pieces.data(), "a.gsyn")
        assert type(caught.value) is expected, value
        assert f"level {level}" in str(caught.value), value


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize("name", ["blocks", "parents", "live", "before", "rows", "body", "raw"])
def test_numbers_of_a_table_that_only_sum_up_are_refused(name: str, level: int) -> None:
    for first, second in ((0, 1), (0, -1), (-1, -2)):
        pieces = taken(DATA)
        table = pieces.tables[level]
        some = (first,) if name != "rows" else (first, 0)
        others = (second,) if name != "rows" else (second, 0)
        table[name][some] += np.array(1, table[name].dtype)
        table[name][others] -= np.array(1, table[name].dtype)
        with pytest.raises(FormatError):
            decode(pieces.data(), "x")


RECORD_BREAKS: dict[str, list[float]] = {
    "stored": [0, 1, 2**27, U32],
    "raw": [0, 1, 2**27, U32],
    "crc": [0, U32],
    "parent": [999, 65535, U32],
    "live": [0, 1, U32],
    "before": [1, 999, U32],
    **{f"low_{axis}": [-(2**31), 2**31 - 1] for axis in "xyz"},
    **{f"high_{axis}": [-(2**31), 2**31 - 1] for axis in "xyz"},
    "reach": [-1.0, np.nan, np.inf, 1e30],
    "width": [0, 7, 9, U32],
}


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize("name", RECORD_BREAKS)
def test_a_broken_field_of_a_page_is_refused(name: str, level: int) -> None:
    assert tuple(RECORD_BREAKS) == BlockEntry._fields
    for value in RECORD_BREAKS[name]:
        pieces = taken(DATA)
        records = pieces.records(level, 1)
        records[name][1] = value
        pieces.put(level, 1, records)
        with pytest.raises(FormatError, match=f"level {level}"):
            decode(pieces.data(), "x")


@pytest.mark.parametrize("level", range(3))
def test_counts_of_a_page_that_only_sum_up_are_refused(level: int) -> None:
    for name in ("live", "before", "stored", "raw", "rows"):
        pieces = taken(DATA)
        records = pieces.records(level, 2)
        records[name][0] += np.array(1, records[name].dtype)
        records[name][1] -= np.array(1, records[name].dtype)
        pieces.put(level, 2, records)
        with pytest.raises(FormatError):
            decode(pieces.data(), "x")


def test_pages_in_another_order_are_refused() -> None:
    for level in range(3):
        pieces = taken(DATA)
        for parts in (pieces.pages[level], pieces.blocks[level]):
            parts[0], parts[1] = parts[1], parts[0]
        table = pieces.tables[level]
        table[[0, 1]] = table[[1, 0]]
        with pytest.raises(FormatError):
            decode(pieces.data(), "x")


def test_changed_tables_and_pages_under_right_checksums_never_crash(
    rng: np.random.Generator,
) -> None:
    for number in range(600):
        pieces = taken(SMALL)
        level = number // 2 % 2
        if number % 2:
            raw = pieces.tables[level].view(np.uint8).reshape(-1)
        else:
            page = int(rng.integers(len(pieces.pages[level])))
            raw = np.frombuffer(pieces.pages[level][page], np.uint8).copy()
        at, run = int(rng.integers(len(raw))), int(rng.integers(1, 5))
        raw[at : at + run] ^= rng.integers(1, 256, len(raw[at : at + run]), np.uint8)
        if not number % 2:
            pieces.pages[level][page] = raw.tobytes()
        data = pieces.data()
        with at_most(4 * MIB) if number % TRACED == 0 else nullcontext():
            try:
                decode(data, "x")
            except FormatError as error:
                assert "\n" not in str(error)


def test_a_bomb_of_a_page_stops_at_its_records() -> None:
    bomb = zlib.compress(bytes(32 * MIB), 9)[2:-4]
    pieces = taken(DATA)
    size = layout.block_entry_bytes(0)
    table = pieces.tables[0]
    old = int(table["stored"][0])
    table["stored"][0], table["crc"][0] = min(len(bomb), 4 * size), zlib.crc32(bomb[: 4 * size])
    index = pieces.index
    number, blocks = pieces.number(Kind.DIRECTORY, 0), index.chunk_of(0, Kind.BLOCKS)
    page = bomb[: 4 * size]
    pieces.bodies[pieces.number(Kind.BLOCKS, 0)] = b""
    data = DATA[: blocks.offset] + page + DATA[blocks.offset + old :]
    chunks = [
        c._replace(offset=c.offset + (len(page) - old) * (c.offset > blocks.offset))
        for c in index.chunks
    ]
    at = index.chunks.index(blocks)
    chunks[at] = blocks._replace(stored=blocks.stored + len(page) - old)
    levels = tuple(v._replace(end=v.end + len(page) - old) for v in index.levels)
    head = pack_index(Index(index.header, levels, tuple(chunks)))
    forged = _with_table(head + data[index.length :], number, deflate(pack_directory(table))[0])
    tracemalloc.start()
    try:
        with pytest.raises(LayoutError, match="level 0 page 0"):
            decode(forged, "x")
        assert tracemalloc.get_traced_memory()[1] < MIB
    finally:
        tracemalloc.stop()


def test_ten_thousand_blocks_a_level_open_with_64_kib() -> None:
    """Of noise as far as directories are noise: lengths, checksums, boxes."""
    rng = np.random.default_rng(1)
    levels: list[LevelPieces] = []
    parent, rows = np.zeros(10_000, np.int64), np.zeros((10_000, 0), np.int64)
    for level in range(4):
        records = np.zeros(10_000, record_type(level))
        records["parent"] = parent
        records["rows"] = np.hstack([rows, rng.integers(100, 4000, (10_000, 1))])
        for name in ("stored", "raw", "crc", "live", "before"):
            records[name] = rng.integers(10_000, 60_000, 10_000)
        for name in ("low_x", "low_y", "low_z", "high_x", "high_y", "high_z"):
            records[name] = rng.integers(-60_000, 60_000, 10_000)
        levels.append(LevelPieces(records, (), ()))
        parent, rows = np.arange(10_000), records["rows"].astype(np.int64)
    pages = cut_pages(levels, 256)
    tables = [len(deflate(pack_directory(level.records))[0]) for level in pages]
    index = layout.index_bytes(4, 1 + 4 * 3)
    assert index + sum(tables) + max(map(len, pages[0].bodies)) < 64 * 1024
    assert max(len(level.records) for level in pages) < 64


def test_pages_come_with_very_many_blocks(tmp_path: Path) -> None:
    """The writer's own choice, through a file of 1,025 blocks and one of 1,024."""
    levels = make_level_set(np.random.default_rng(6), replace(SPLATS, anchors=(3000,)))
    account = write_gsyn(levels, tmp_path / "many.gsyn", block=2)
    assert any(part.kind == "pages" for part in account.parts)
    check_file(tmp_path / "many.gsyn")
    account = write_gsyn(levels, tmp_path / "few.gsyn", block=64)
    assert not any(part.kind == "pages" for part in account.parts)
