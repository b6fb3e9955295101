"""Damaged and hostile bytes: refused, in little memory, without a crash."""

import struct
import tracemalloc
import zlib
from contextlib import nullcontext

import numpy as np
import pytest

from benchmarks.robust.forge import (
    flat,
    index_of,
    mended,
    number_of,
    taken,
    with_chunk,
    with_level,
    with_record,
)
from gsynopsis.container import decode, encode, layout
from gsynopsis.container.layout import Kind
from gsynopsis.errors import FormatError, LayoutError
from gsynopsis.records import LevelSet
from tests.level_sets import BOTH, FREE, Shape, make_level_set
from tests.memory import TRACED, at_most

MUTATIONS = 2000
MIB = 1 << 20
FILES = [
    encode(make_level_set(np.random.default_rng(1), Shape()), "compact"),
    encode(make_level_set(np.random.default_rng(2), BOTH), "raw"),
    encode(make_level_set(np.random.default_rng(3), FREE), "compact"),
]

FLAT = [flat(data) for data in FILES]


def mutated(rng: np.random.Generator, data: bytes, start: int = 0) -> bytes:
    """One to eight bytes changed from `start` on, single bits or runs; length as it was."""
    changed = bytearray(data)
    if rng.integers(2):
        at = int(rng.integers(start, len(data)))
        changed[at] ^= 1 << int(rng.integers(8))
    else:
        at = int(rng.integers(start, len(data)))
        run = rng.bytes(int(rng.integers(1, 9)))[: len(data) - at]
        changed[at : at + len(run)] = run
    return bytes(changed)


def outcome(data: bytes) -> LevelSet | FormatError:
    try:
        return decode(data, "x")
    except FormatError as error:
        assert "\n" not in str(error)
        return error


def test_no_changed_byte_is_accepted(rng: np.random.Generator) -> None:
    done = 0
    while done < MUTATIONS:
        original = FILES[done % len(FILES)]
        data = mutated(rng, original)
        if data == original:
            continue
        with at_most(MIB) if done % TRACED == 0 else nullcontext():
            assert isinstance(outcome(data), FormatError), f"mutation {done}"
        done += 1


def test_changed_bytes_under_right_checksums_never_crash(rng: np.random.Generator) -> None:
    """What an attacker sends: the tables, or a chunk, changed and every checksum made right."""
    accepted = 0
    for number in range(MUTATIONS):
        original = FLAT[number % len(FILES)]
        length = index_of(original).length
        part = number // len(FILES) % 2
        head = mutated(rng, original[:length], start=20) if part else original[:length]
        body = original[length:] if part else mutated(rng, original[length:])
        with at_most(4 * MIB) if number % TRACED == 0 else nullcontext():
            result = outcome(mended(head + body))
        accepted += isinstance(result, LevelSet)
    assert 0 < accepted < MUTATIONS / 2, "changed values may be valid, changed counts may not"


def test_every_single_bit_of_the_index_counts() -> None:
    data = FILES[0]
    for at in range(index_of(data).length):
        for bit in range(8):
            changed = bytearray(data)
            changed[at] ^= 1 << bit
            assert isinstance(outcome(bytes(changed)), FormatError), (at, bit)


@pytest.mark.parametrize("claim", [2**16, 2**24, 2**31 - 1])
def test_a_count_beyond_the_bytes_allocates_nothing(claim: int) -> None:
    data = FILES[0]
    forgeries = [
        with_level(data, 3, anchors=claim, live=claim),
        with_chunk(data, number_of(data, Kind.GRID), rows=claim, raw=4 * claim),
        with_chunk(data, number_of(data, Kind.BLOCKS), raw=claim),
        with_chunk(data, 0, rows=claim, raw=claim),
        with_record(data, 3, 0, raw=min(claim, 2**27)),
        with_record(data, 3, 0, live=claim, before=claim),
    ]
    tracemalloc.start()
    try:
        for forged in forgeries:
            assert isinstance(outcome(forged), FormatError)
        assert tracemalloc.get_traced_memory()[1] < MIB
    finally:
        tracemalloc.stop()


def test_a_deflate_bomb_stops_at_the_declared_length() -> None:
    bomb = zlib.compress(bytes(64 * MIB), 9)[2:-4]
    pieces = taken(FILES[0])
    grid = number_of(FILES[0], Kind.GRID)
    pieces.set_body(grid, bomb, rows=40000, raw=16 + 80000)
    forged = pieces.data()
    tracemalloc.start()
    try:
        with pytest.raises(LayoutError, match="grid 0: found more than"):
            decode(forged, "x")
        assert tracemalloc.get_traced_memory()[1] < MIB
    finally:
        tracemalloc.stop()


def test_an_honest_bomb_is_out_of_proportion() -> None:
    """A grid of 72 MiB of zeros in 72 KiB is well formed and refused all the same."""
    number = number_of(FILES[0], Kind.GRID)
    rows = 9 * MIB
    bomb = zlib.compress(bytes(8 * rows), 9)[2:-4]
    pieces = taken(FILES[0])
    pieces.set_body(number, bomb, rows=rows, raw=8 * rows, coding=0)
    forged = pieces.data()
    assert len(forged) < 128 * 1024
    with pytest.raises(LayoutError, match=r"raw: found \d+"):
        decode(forged, "x")


@pytest.mark.parametrize(
    "data", [b"\0", b"GSYN", layout.MAGIC, bytes(80), bytes(16384), b"\xff" * 20000]
)
def test_bytes_that_are_no_file_are_refused(data: bytes) -> None:
    assert isinstance(outcome(data), FormatError)


def test_noise_behind_a_good_magic_and_version_is_refused(rng: np.random.Generator) -> None:
    head = layout.MAGIC + struct.pack("<II", layout.VERSION, 0)
    for _ in range(300):
        assert isinstance(outcome(head + rng.bytes(int(rng.integers(0, 3000)))), FormatError)
