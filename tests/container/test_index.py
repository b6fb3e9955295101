"""Every field of header and tables, broken one at a time with all checksums right."""

import math
import zlib

import numpy as np
import pytest

from benchmarks.robust.forge import index_of, number_of, with_chunk, with_header, with_level
from gsynopsis.container import decode, encode, layout
from gsynopsis.container.index import check_chunks, parse_index, values_per_anchor
from gsynopsis.container.layout import ChunkEntry, Header, Kind, LevelEntry
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import (
    ChecksumError,
    FormatError,
    LayoutError,
    NotGsynError,
    TruncatedError,
    ValueRangeError,
    VersionError,
)
from tests.level_sets import BOTH, COMMON, Shape, make_level_set

DATA = encode_with_account(make_level_set(np.random.default_rng(7), BOTH), block=8)[0]
INDEX = index_of(DATA)
NAN, INF = math.nan, math.inf

HEADER_BREAKS: dict[str, tuple[type[FormatError], list[object]]] = {
    "magic": (NotGsynError, [b"GSYN\n\x1a\n\n", b"gsyn\r\n\x1a\n", bytes(8)]),
    "version": (VersionError, [0, 2, 2**32 - 1]),
    "required": (VersionError, [16, 17, 1 << 31]),
    "levels": (LayoutError, [0, 17, 65535]),
    "chunks": (LayoutError, [0, 1, 321, 65535]),
    "slots": (LayoutError, [0, 1, 3, 5, 257, 65535]),
    "features": (LayoutError, [0, 1, 3, 257, 65535]),
    "residual": (LayoutError, [0, 2, 4, 1025, 65535]),
    "contract": (LayoutError, [2, 65535]),
    "front": (LayoutError, [0, 2, 65535]),
    "stand_ins": (LayoutError, [1, 16, 65535]),
    "head": (LayoutError, [0, 88, INDEX.header.head + 1, 2**32 - 1]),
    "voxel": (ValueRangeError, [0.0, -1.0, NAN, INF]),
    "center_x": (ValueRangeError, [NAN, INF, -INF]),
    "center_y": (ValueRangeError, [NAN, INF, -INF]),
    "center_z": (ValueRangeError, [NAN, INF, -INF]),
    "radius": (ValueRangeError, [0.0, -1.0, NAN, INF]),
    "extent": (ValueRangeError, [0.0, -1.0, NAN, INF]),
}
LEVEL_BREAKS: dict[str, tuple[type[FormatError], list[object]]] = {
    "end": (LayoutError, [0, 1, len(DATA) + 1, 2**63, 2**64 - 1]),
    "anchors": (LayoutError, [0, 1, 41, 2**31 - 1, 2**31, 2**32 - 1]),
    "live": (LayoutError, [0, 1, 2**32 - 1]),
    "blocks": (LayoutError, [0, 11, 65537, 2**32 - 1]),
    "grids": (LayoutError, [0, 4, 64, 65, 65535]),
    "head_hidden": (LayoutError, [0, 3, 5, 4097]),
    "fuse_hidden": (LayoutError, [0, 5, 7, 4097]),
    "fuse_out": (LayoutError, [0, 4, 6, 4097]),
    "codebook_rows": (LayoutError, [0, 4, 6, 257]),
    "codebook_columns": (LayoutError, [0, 2, 4, 1025]),
    "log_scales": (LayoutError, [0, 5, 255]),
    "residual": (LayoutError, [0, 5, 255]),
    "offsets": (LayoutError, [0, 5, 255]),
    "inherits": (LayoutError, [1, 2, 255]),
    "gain_x": (ValueRangeError, [0.0, -1.0, NAN, INF]),
    "gain_y": (ValueRangeError, [0.0, -1.0, NAN, INF]),
    "gain_z": (ValueRangeError, [0.0, -1.0, NAN, INF]),
}
CHUNK_BREAKS: dict[str, tuple[type[FormatError], list[object]]] = {
    "kind": (LayoutError, [0, 7, 255]),
    "level": (LayoutError, [4, 16, 255]),
    "coding": (LayoutError, [5, 255]),
    "part": (LayoutError, [7, 64, 255]),
    "offset": (LayoutError, [0, 1, len(DATA), 2**63, 2**64 - 1]),
    "stored": (LayoutError, [0, len(DATA), 2**63, 2**64 - 1]),
    "raw": (LayoutError, [0, 1, 2**40, 2**63, 2**64 - 1]),
    "rows": (LayoutError, [0, 77, 2**32 - 1]),
    "resolution": (LayoutError, [2**20 + 1, 2**32 - 1]),
}


def test_the_tables_below_break_every_field() -> None:
    assert [*HEADER_BREAKS, "crc"] == sorted([*Header._fields], key=[*HEADER_BREAKS, "crc"].index)
    assert tuple(LEVEL_BREAKS) == LevelEntry._fields
    assert {*CHUNK_BREAKS, "crc"} == set(ChunkEntry._fields)


@pytest.mark.parametrize("name", HEADER_BREAKS)
def test_a_broken_field_of_the_header_is_refused(name: str) -> None:
    expected, values = HEADER_BREAKS[name]
    for value in values:
        with pytest.raises(expected) as caught:
            decode(with_header(DATA, **{name: value}), "a.gsyn")
        assert type(caught.value) is expected
        assert str(caught.value).startswith("a.gsyn: ")


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("name", LEVEL_BREAKS)
def test_a_broken_field_of_a_level_is_refused(name: str, number: int) -> None:
    expected, values = LEVEL_BREAKS[name]
    for value in values:
        if value == getattr(INDEX.levels[number], name):
            continue
        with pytest.raises(expected) as caught:
            decode(with_level(DATA, number, **{name: value}), "a.gsyn")
        assert type(caught.value) is expected, value


def test_matrices_are_inherited_from_the_level_before_if_they_can_be() -> None:
    data = encode(make_level_set(np.random.default_rng(7), COMMON))
    index = index_of(data)
    assert [level.inherits for level in index.levels] == [0, 1, 1, 1]
    assert [index.owner_of(level) for level in range(4)] == [0, 0, 0, 0]
    first, *others = [chunk.rows for chunk in index.chunks if chunk.kind == Kind.NETWORKS]
    assert others == [3 * 4 + 11 * 4] * 3  # three heads 4 wide, 11 outputs for each of 4 slots
    assert first > others[0]
    broken = {
        "required": with_header(data, required=0),
        "level 0: inherits": with_level(data, 0, inherits=1),
        "level 2: inherits": with_level(data, 2, head_hidden=5),
        "rows": with_level(data, 2, inherits=0),
    }
    for where, bytes_ in broken.items():
        with pytest.raises(LayoutError, match=where):
            decode(bytes_, "a.gsyn")
    with pytest.raises(LayoutError, match="required"):
        decode(with_header(DATA, required=layout.TIED_WEIGHTS), "a.gsyn")


@pytest.mark.parametrize("number", range(len(INDEX.chunks)))
@pytest.mark.parametrize("name", CHUNK_BREAKS)
def test_a_broken_field_of_a_chunk_is_refused(name: str, number: int) -> None:
    expected, values = CHUNK_BREAKS[name]
    for value in values:
        with pytest.raises(expected) as caught:
            decode(with_chunk(DATA, number, **{name: value}), "a.gsyn")
        assert type(caught.value) is expected, value


@pytest.mark.parametrize("number", range(len(INDEX.chunks)))
def test_a_wrong_checksum_of_a_chunk_is_refused(number: int) -> None:
    blocks = INDEX.chunks[number].kind == Kind.BLOCKS
    with pytest.raises(LayoutError if blocks else ChecksumError, match=r"CRC-32|crc: found 1"):
        decode(with_chunk(DATA, number, crc=INDEX.chunks[number].crc ^ 1), "a.gsyn")


def test_a_wrong_checksum_of_the_index_is_refused() -> None:
    at = layout.offsets_of(Header)["crc"]
    data = DATA[:at] + bytes([DATA[at] ^ 1]) + DATA[at + 1 :]
    with pytest.raises(ChecksumError, match="index"):
        decode(data, "a.gsyn")


@pytest.mark.parametrize("step", [-1, 1])
def test_a_wrong_count_of_records_moves_the_tables_and_is_refused(step: int) -> None:
    header = INDEX.header
    for fields in ({"levels": header.levels + step}, {"chunks": header.chunks + step}):
        data = with_header(DATA, **fields)
        with pytest.raises(ChecksumError):
            decode(data, "a.gsyn")
        with pytest.raises(LayoutError):
            decode(recounted(data), "a.gsyn")


def recounted(data: bytes) -> bytes:
    """The checksum over as many bytes as the counts of the header now say."""
    header = Header._make(layout.HEADER.unpack_from(data))
    length = layout.index_bytes(header.levels, header.chunks)
    tables = data[layout.HEADER.size : length]
    crc = zlib.crc32(tables, zlib.crc32(layout.HEADER.pack(*header._replace(crc=0))))
    return layout.HEADER.pack(*header._replace(crc=crc)) + data[layout.HEADER.size :]


def test_tables_beyond_16_kib_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layout, "INDEX_BYTES_MAX", INDEX.length - 1)
    with pytest.raises(LayoutError, match=f"found {INDEX.length} bytes"):
        decode(DATA, "a.gsyn")


def test_swapped_chunks_are_refused() -> None:
    chunks = list(INDEX.chunks)
    one, two = number_of(DATA, Kind.NETWORKS), number_of(DATA, Kind.CODEBOOK)
    chunks[one], chunks[two] = chunks[two], chunks[one]
    data = with_chunk(with_chunk(DATA, one, **chunks[one]._asdict()), two, **chunks[two]._asdict())
    with pytest.raises(LayoutError, match=f"chunk {one}: kind: found 4, expected 3"):
        decode(data, "a.gsyn")


def test_a_coding_belongs_to_chunks_of_values_and_gives_their_length() -> None:
    for kind in (Kind.MANIFEST, Kind.DIRECTORY, Kind.BLOCKS):
        with pytest.raises(LayoutError, match="coding: found 2, expected 0"):
            decode(with_chunk(DATA, number_of(DATA, kind), coding=2), "a.gsyn")
    with pytest.raises(LayoutError, match="raw: found"):
        decode(with_chunk(DATA, number_of(DATA, Kind.GRID), coding=0), "a.gsyn")


def test_a_resolution_belongs_to_grids_and_rises() -> None:
    with pytest.raises(LayoutError, match="resolution: found 3, expected 0"):
        decode(with_chunk(DATA, number_of(DATA, Kind.BLOCKS), resolution=3), "a.gsyn")
    with pytest.raises(LayoutError, match="expected more than 3"):
        decode(with_chunk(DATA, number_of(DATA, Kind.GRID, 2), resolution=3), "a.gsyn")
    with pytest.raises(LayoutError, match="expected more than 1"):
        decode(with_chunk(DATA, number_of(DATA, Kind.GRID), resolution=0), "a.gsyn")


def test_a_manifest_beyond_its_cap_is_refused() -> None:
    with pytest.raises(LayoutError, match="at most 65536"):
        decode(with_chunk(DATA, 0, rows=65537, raw=65537), "a.gsyn")


def test_a_codebook_at_some_levels_only_is_refused() -> None:
    data = encode(make_level_set(np.random.default_rng(1), Shape(anchors=(3, 5), grids=(1, 1))))
    with pytest.raises(LayoutError, match="codebook_rows"):
        decode(with_level(data, 1, codebook_rows=0), "a.gsyn")


def test_claims_out_of_proportion_to_the_bytes_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    index = parse_index(DATA, "a.gsyn")
    monkeypatch.setattr(layout, "EXPANSION_MAX", 0)
    end = index.levels[0].end
    raw = sum(chunk.raw for chunk in index.chunks if chunk.offset < end)
    monkeypatch.setattr(layout, "RAW_BYTES_BASE", raw - 1)
    with pytest.raises(LayoutError, match=f"level 0: raw: found {raw} bytes"):
        check_chunks(index, "a.gsyn")
    monkeypatch.setattr(layout, "RAW_BYTES_BASE", 1 << 26)
    monkeypatch.setattr(layout, "SLOTS_BASE", index.levels[0].anchors * 4 - 1)
    with pytest.raises(LayoutError, match="level 0: slots"):
        check_chunks(index, "a.gsyn")


def test_the_first_bytes_decide_what_is_missing() -> None:
    with pytest.raises(TruncatedError, match="found 0 bytes, expected 88 bytes"):
        parse_index(b"", "a.gsyn")
    with pytest.raises(NotGsynError):
        parse_index(b"PK\x03\x04", "a.zip")
    with pytest.raises(TruncatedError, match="index: found 88 bytes"):
        parse_index(DATA[:88], "a.gsyn")


def test_bytes_after_the_tables_do_not_matter_to_them() -> None:
    assert parse_index(DATA[: INDEX.length], "a") == parse_index(DATA, "a") == INDEX


def test_values_of_all_anchors_are_in_proportion_to_the_bytes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A renderer holds features, hidden values and outputs of all anchors at once."""
    index = parse_index(DATA, "a.gsyn")
    sums = [level.anchors * values_per_anchor(index.header, level) for level in index.levels]
    monkeypatch.setattr(layout, "VALUES_EXPANSION_MAX", 0)
    monkeypatch.setattr(layout, "VALUES_BASE", max(sums))
    decode(DATA, "a.gsyn")
    monkeypatch.setattr(layout, "VALUES_BASE", max(sums) - 1)
    with pytest.raises(LayoutError, match=rf"values: found {max(sums)}, expected at most"):
        decode(DATA, "a.gsyn")


def test_a_level_has_no_more_blocks_than_anchors() -> None:
    """Blocks of nothing take no bytes, but time: 90 KB of them once took 22 seconds to check."""
    anchors = parse_index(DATA, "a.gsyn").levels[0].anchors
    with pytest.raises(LayoutError, match=rf"blocks: found {anchors + 1}, expected at most"):
        decode(with_level(DATA, 0, blocks=anchors + 1), "a.gsyn")
