from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsynopsis.errors import (
    ChecksumError,
    FormatError,
    InputError,
    LayoutError,
    TruncatedError,
    ValueRangeError,
)
from gsynopsis.pack import Assembler, decode, encode, read_gsyn, reader, write_gsyn
from gsynopsis.pack.layout import CodingId, Kind
from gsynopsis.records import LevelSet
from tests.level_sets import BOTH, SHAPES, Shape, assert_same, make_level_set
from tests.pack.forge import index_of, number_of, with_array, with_stored

CODINGS = ("raw", "compact")


@st.composite
def level_sets(draw: st.DrawFn) -> LevelSet:
    depth = draw(st.integers(1, 4))
    rising = st.lists(st.integers(0, 30), min_size=depth, max_size=depth).map(sorted)
    grids = draw(st.lists(st.integers(0, 3), min_size=depth, max_size=depth).map(sorted))
    entries = draw(st.sampled_from([0, 1, 7, 256]))
    shape = Shape(
        anchors=tuple(draw(rising)),
        slots=draw(st.integers(1, 11)),
        grids=tuple(grids),
        features=draw(st.integers(1, 4)),
        entries=entries,
        code_width=3 if entries else 0,
        residual=draw(st.sampled_from([0, 1, 32])),
        hidden=draw(st.integers(1, 5)),
        fuse=draw(st.sampled_from([None, (1, 1), (4, 3)])),
        keep=draw(st.sampled_from([0.0, 0.3, 1.0])),
    )
    return make_level_set(np.random.default_rng(draw(st.integers(0, 2**32))), shape)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(level_sets())
def test_raw_gives_back_every_bit_of_what_lives(levels: LevelSet) -> None:
    assert_same(decode(encode(levels, "raw"), "x"), levels.upto(len(levels.levels) - 1))


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(level_sets(), st.sampled_from(CODINGS))
def test_a_prefix_after_level_k_is_the_file_of_level_k(levels: LevelSet, coding: str) -> None:
    data = encode(levels, coding)
    whole = decode(data, "x")
    assert encode(whole, coding) == data
    for k, level in enumerate(index_of(data).levels):
        prefix = decode(data[: level.end], "x")
        assert_same(prefix, whole.upto(k))
        assert_same(prefix, decode(data, "x", k))


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize("name", SHAPES)
def test_a_client_that_applied_deltas_has_what_a_direct_load_has(name: str, coding: str) -> None:
    data = encode(make_level_set(np.random.default_rng(3), SHAPES[name]), coding)
    whole = decode(data, "x")
    by_chunk = Assembler(data[:16384], "x")
    by_level = Assembler(data[: by_chunk.index.length], "x")
    for k, level in enumerate(by_chunk.index.levels):
        for chunk in by_chunk.index.chunks_of(k):
            assert by_chunk.levels_ready == k
            by_chunk.add(data[chunk.offset : chunk.offset + chunk.stored])
        start = by_level.index.start_of(k)
        assert by_level.next_bytes == level.end - start
        by_level.add_level(data[start : level.end])
        assert by_chunk.levels_ready == by_level.levels_ready == k + 1
        assert_same(by_chunk.level_set(), decode(data[: level.end], "x"))
        assert_same(by_level.level_set(), whole.upto(k))
    assert by_chunk.next_chunk is None
    assert by_chunk.next_bytes == 0


@pytest.mark.parametrize("name", ["small", "free", "empty"])
def test_every_other_length_is_refused(name: str) -> None:
    levels = make_level_set(np.random.default_rng(5), SHAPES[name])
    data = encode(levels)
    ends = {level.end for level in index_of(data).levels}
    for length in range(len(data)):
        if length not in ends:
            with pytest.raises(TruncatedError):
                decode(data[:length], "x")
    with pytest.raises(TruncatedError):
        decode(data + b"\0", "x")


def test_what_a_client_gets_is_its_own() -> None:
    data = encode(make_level_set(np.random.default_rng(1), BOTH))
    client = Assembler(data, "x")
    for k, level in enumerate(client.index.levels):
        buffer = bytearray(data[client.index.start_of(k) : level.end])
        client.add_level(buffer)
        buffer[:] = bytes(len(buffer))
        got = client.level_set()
        got.levels[0].mask[:] = True
        got.shared.grids[0][:] = 7
        got.levels[0].codebook[:] = 7
        got.levels[0].networks["cov_b1"][:] = 7
        got.shared.lattice[:] = 7
    assert_same(client.level_set(), decode(data, "x"))


def test_a_client_refuses_what_is_not_next_and_goes_on_with_what_is() -> None:
    data = encode(make_level_set(np.random.default_rng(1)))
    client = Assembler(data, "x")
    chunks = client.index.chunks
    bodies = [data[c.offset : c.offset + c.stored] for c in chunks]
    with pytest.raises(LayoutError, match="no complete level"):
        client.level_set()
    for number, body in enumerate(bodies):
        with pytest.raises(TruncatedError):
            client.add(body + b"\0")
        with pytest.raises(ChecksumError):
            client.add(bytes(len(body)))
        with pytest.raises(TruncatedError):
            client.add_level(body[:-1] if number + 1 == len(bodies) else b"")
        client.add(body)
    with pytest.raises(LayoutError, match="after the last"):
        client.add(b"")
    assert_same(client.level_set(), decode(data, "x"))


SMALL = encode(make_level_set(np.random.default_rng(11), BOTH))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("coding", [CodingId.PLAIN, CodingId.SHUFFLE, CodingId.HALF])
@pytest.mark.parametrize(
    "kind",
    [Kind.NETWORKS, Kind.CODEBOOK, Kind.GRID, Kind.LOG_SCALES, Kind.RESIDUAL, Kind.OFFSETS],
)
def test_a_number_that_is_not_finite_is_refused(kind: Kind, coding: CodingId, value: float) -> None:
    number = number_of(SMALL, kind)
    chunk = index_of(SMALL).chunks[number]
    array = np.zeros((chunk.rows, chunk.columns), np.float32)
    array[-1, -1] = value
    with np.errstate(invalid="ignore"):
        data = with_array(SMALL, number, array, coding)
    with pytest.raises(ValueRangeError, match=f"{kind.label}.*in row {chunk.rows - 1}"):
        decode(data, "x")


def test_a_code_beyond_the_codebook_of_any_of_its_levels_is_refused() -> None:
    for level, rows in enumerate((4, 7, 12, 17)):
        number = number_of(SMALL, Kind.CODES, level)
        codes = np.full((rows, 1), 5, np.uint8)
        with pytest.raises(ValueRangeError, match=f"level {level} codes: found 5, expected below"):
            decode(with_array(SMALL, number, codes, CodingId.SHUFFLE), "x")


def test_a_mask_that_does_not_fit_the_counts_is_refused() -> None:
    number = number_of(SMALL, Kind.MASK)
    for value in (0, 255):
        array = np.full((2, 1), value, np.uint8)
        with pytest.raises(LayoutError, match=r"level 0 mask: found \d+ live slots"):
            decode(with_array(SMALL, number, array, CodingId.PLAIN), "x")


def test_bits_beyond_the_mask_and_anchors_without_a_slot_are_refused() -> None:
    levels = make_level_set(np.random.default_rng(2), Shape(anchors=(3,), grids=(1,), slots=3))
    level = levels.levels[0]
    mask = np.array([[1, 1, 0], [0, 1, 0], [0, 1, 1]], np.bool_)
    data = encode(replace(levels, levels=(replace(level, mask=mask),)))
    number = number_of(data, Kind.MASK)
    bits = np.append(mask.ravel(), np.zeros(7, np.bool_))
    bits[-1] = True
    padded = np.packbits(bits, bitorder="little")[:, None]
    with pytest.raises(LayoutError, match="padding bits"):
        decode(with_array(data, number, padded, CodingId.PLAIN), "x")
    moved = np.array([[1, 1, 1], [0, 0, 0], [0, 1, 1]], np.bool_)
    empty = np.packbits(moved.ravel(), bitorder="little")[:, None]
    with pytest.raises(LayoutError, match="anchor 1 without a live slot"):
        decode(with_array(data, number, empty, CodingId.PLAIN), "x")


@pytest.mark.parametrize("number", range(len(index_of(SMALL).chunks)))
def test_a_chunk_that_is_no_zlib_stream_is_refused(number: int) -> None:
    chunk = index_of(SMALL).chunks[number]
    stored = SMALL[chunk.offset : chunk.offset + chunk.stored]
    for bad in (stored + b"\0", stored[:-1], b"\0" * 9, stored[:1]):
        with pytest.raises(LayoutError, match=r"zlib stream|inflated bytes"):
            decode(with_stored(SMALL, number, bad), "x")


@pytest.mark.parametrize("level", [-1, 4, 100])
def test_a_level_that_is_not_there_is_refused(level: int) -> None:
    with pytest.raises(InputError, match="level: found"):
        decode(SMALL, "x", level)


def test_a_file_reads_as_its_bytes_do_at_every_level(tmp_path: Path) -> None:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(SMALL)
    assert_same(read_gsyn(path), decode(SMALL, "x"))
    for k in range(4):
        assert_same(read_gsyn(path, k), decode(SMALL, "x", k))


def test_reading_a_level_does_not_touch_what_lies_behind(tmp_path: Path) -> None:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(SMALL[:-1] + bytes([SMALL[-1] ^ 1]))
    assert_same(read_gsyn(path, 2), decode(SMALL, "x", 2))
    with pytest.raises(ChecksumError, match="level 3 offsets"):
        read_gsyn(path)


def test_a_missing_file_or_a_folder_is_one_clear_line(tmp_path: Path) -> None:
    for path in (tmp_path / "no.gsyn", tmp_path):
        with pytest.raises(InputError, match=r"expected a readable \.gsyn file") as caught:
            read_gsyn(path)
        assert not isinstance(caught.value, FormatError)


def test_whatever_records_still_refuse_is_a_layout_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> None:
        raise ValueError("level 0: no")

    monkeypatch.setattr(reader, "LevelSet", refuse)
    with pytest.raises(LayoutError, match="x: found level 0: no"):
        decode(SMALL, "x")


def test_a_large_level_set_decodes_as_it_was(tmp_path: Path) -> None:
    shape = Shape(anchors=(500, 3000), slots=10, grids=(1, 2))
    levels = make_level_set(np.random.default_rng(0), shape)
    write_gsyn(levels, tmp_path / "a.gsyn", "raw")
    assert_same(read_gsyn(tmp_path / "a.gsyn"), levels.upto(1))
