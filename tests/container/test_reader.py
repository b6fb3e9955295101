from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.robust.forge import index_of, taken
from gsynopsis.container import decode, encode, read_gsyn, write_gsyn
from gsynopsis.container.codecs import deflate
from gsynopsis.container.layout import Kind
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import ChecksumError, FormatError, InputError, LayoutError, TruncatedError
from gsynopsis.records import LevelSet
from tests.level_sets import ALL_SHAPES, BOTH, Shape, assert_same, make_level_set

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
@given(level_sets(), st.integers(2, 20))
def test_raw_gives_back_every_bit_of_what_lives(levels: LevelSet, size: int) -> None:
    data = encode_with_account(levels, "raw", block=size)[0]
    assert_same(decode(data, "x"), levels.upto(len(levels.levels) - 1))


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(level_sets(), st.sampled_from(CODINGS), st.integers(2, 20))
def test_a_prefix_after_level_k_is_the_file_of_level_k(
    levels: LevelSet, coding: str, size: int
) -> None:
    data = encode_with_account(levels, coding, block=size)[0]
    whole = decode(data, "x")
    for k, level in enumerate(index_of(data).levels):
        prefix = decode(data[: level.end], "x")
        assert_same(prefix, whole.upto(k))
        assert_same(prefix, decode(data, "x", k))


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(level_sets())
def test_coding_what_was_decoded_changes_no_value(levels: LevelSet) -> None:
    once = decode(encode(levels), "x")
    assert_same(decode(encode(once), "x"), once)


@pytest.mark.parametrize("name", ["small", "free", "empty"])
def test_every_other_length_is_refused(name: str) -> None:
    levels = make_level_set(np.random.default_rng(5), ALL_SHAPES[name])
    data = encode(levels)
    ends = {level.end for level in index_of(data).levels}
    for length in range(len(data)):
        if length not in ends:
            with pytest.raises(TruncatedError):
                decode(data[:length], "x")
    with pytest.raises(TruncatedError):
        decode(data + b"\0", "x")


SMALL = encode_with_account(make_level_set(np.random.default_rng(11), BOTH), block=8)[0]


@pytest.mark.parametrize("number", range(len(index_of(SMALL).chunks)))
def test_a_chunk_that_is_no_deflate_stream_is_refused(number: int) -> None:
    pieces = taken(SMALL)
    chunk, body = pieces.chunks[number], pieces.bodies[number]
    if chunk.kind in (Kind.DIRECTORY, Kind.BLOCKS) or chunk.stored == chunk.raw:
        return
    for bad in (body + b"\0", body[:-1], b"\0" * 9, body[:1]):
        pieces = taken(SMALL)
        pieces.set_body(number, bad)
        with pytest.raises(LayoutError, match=r"DEFLATE stream|inflated bytes|at most"):
            decode(pieces.data(), "x")


def test_a_stream_of_another_length_is_refused() -> None:
    pieces = taken(SMALL)
    pieces.set_body(0, deflate(bytes(300))[0])
    with pytest.raises(LayoutError, match="manifest: found more than"):
        decode(pieces.data(), "x")


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
    with pytest.raises(ChecksumError, match=r"level 3 block \d+"):
        read_gsyn(path)


def test_a_missing_file_or_a_folder_is_one_clear_line(tmp_path: Path) -> None:
    for path in (tmp_path / "no.gsyn", tmp_path):
        with pytest.raises(InputError, match=r"expected a readable \.gsyn file") as caught:
            read_gsyn(path)
        assert not isinstance(caught.value, FormatError)


def test_a_large_level_set_decodes_as_it_was(tmp_path: Path) -> None:
    shape = Shape(anchors=(500, 3000), slots=10, grids=(1, 2))
    levels = make_level_set(np.random.default_rng(0), shape)
    write_gsyn(levels, tmp_path / "a.gsyn", "raw")
    assert_same(read_gsyn(tmp_path / "a.gsyn"), levels.upto(1))
