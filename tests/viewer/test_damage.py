"""Damaged and forged files: the viewer refuses what Python refuses, with a word for it."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.robust.forge import (
    counted_for_sisters,
    number_of,
    taken,
    with_chunk,
    with_header,
    with_level,
)
from gsynopsis.container import decode, encode, layout
from gsynopsis.container.codecs import deflate
from gsynopsis.container.index import parse_index
from gsynopsis.container.layout import Kind
from gsynopsis.errors import FormatError
from tests.container import test_paged as paged
from tests.container.test_directory import DATA
from tests.container.test_manifest import BAD
from tests.level_sets import BOTH, make_level_set
from tests.viewer.node import needs_node, run_node

pytestmark = needs_node
MUTATIONS = 1000
FRAME = ("voxel", "radius", "extent")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("damage") / "whole.gsyn"
    path.write_bytes(encode(make_level_set(np.random.default_rng(11), BOTH), "compact"))
    return path


def opened(file: Path, cases: list[list[object]]) -> list[str]:
    """What the viewer says to each case."""
    request = file.parent / "request.json"
    request.write_text(json.dumps({"file": str(file), "cases": cases}))
    return json.loads(run_node("mutate.mjs", request))


def as_files(file: Path, contents: list[bytes]) -> list[list[object]]:
    """Cases of whole files, put beside another."""
    paths = [file.parent / f"forged{number}.gsyn" for number in range(len(contents))]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    return [["file", str(path), 0] for path in paths]


def mutated(data: bytes, case: list[object]) -> bytes:
    kind, place, value = case
    assert isinstance(place, int) and isinstance(value, int)
    changed = bytearray(data)
    if kind == "flip":
        changed[place] ^= value
    elif kind == "cut":
        del changed[place:]
    elif kind == "tail":
        changed += bytes([value]) * place
    else:
        changed[place : place + value] = bytes(min(value, len(data) - place))
    return bytes(changed)


def test_a_thousand_damaged_files_are_refused_without_a_crash(file: Path) -> None:
    rng = np.random.default_rng(5)
    data = file.read_bytes()
    ends = {level.end for level in parse_index(data, "whole").levels}
    cases: list[list[object]] = []
    while len(cases) < MUTATIONS:
        place = int(rng.integers(len(data)))
        kind = ("flip", "flip", "cut", "tail", "zero")[len(cases) % 5]
        value = int(rng.integers(1, 256))
        case: list[object] = [kind, place % 50 + 1 if kind == "tail" else place, value]
        changed = mutated(data, case)
        if changed != data and len(changed) not in ends - {len(data)}:
            cases.append(case)
    answers = opened(file, cases)
    pairs = zip(cases, answers, strict=True)
    wrong = [f"{c}: {a}" for c, a in pairs if a == "accepted" or a.startswith("CRASH")]
    assert not wrong, wrong[:5]
    assert opened(file, [["flip", 0, 0]]) == ["accepted"], "the file itself must be accepted"
    assert opened(file, [["cut", end, 0] for end in sorted(ends)]) == ["accepted"] * len(ends)


def test_live_slots_of_the_level_before_are_those_that_it_showed(file: Path) -> None:
    forged = list(counted_for_sisters(DATA, 2))
    answers = opened(file, as_files(file, forged))
    assert answers == ["LayoutError"] * len(forged)
    assert forged


def test_false_pages_are_refused_as_by_python(file: Path) -> None:
    """Every field of a page table and of a page, with all checksums right."""
    forged: list[bytes] = []
    for level in range(3):
        for name, (_, values) in paged.TABLE_BREAKS.items():
            for value in values:
                pieces = paged.taken(paged.DATA)
                pieces.tables[level][name][1] = value
                forged.append(pieces.data())
        for name, values in paged.RECORD_BREAKS.items():
            for value in values:
                pieces = paged.taken(paged.DATA)
                records = pieces.records(level, 1)
                records[name][1] = value
                pieces.put(level, 1, records)
                forged.append(pieces.data())
    forged = [data for data in forged if data != paged.DATA]
    wanted: list[str] = []
    for data in forged:
        try:
            decode(data, "x")
            wanted.append("accepted")
        except FormatError as error:
            wanted.append(type(error).__name__)
    answers = opened(file, as_files(file, [*forged, paged.DATA]))
    assert answers.pop() == "accepted"
    assert [w == "accepted" for w in wanted] == [a == "accepted" for a in answers]
    assert all(
        a.endswith("Error") and not a.startswith("CRASH") for a in answers if a != "accepted"
    )
    differ = [(w, a) for w, a in zip(wanted, answers, strict=True) if w != a]
    assert len(differ) < len(answers) / 10, differ


def unusable(data: bytes) -> list[bytes]:
    """Files with right checksums that are beyond a limit, or hide bytes where none may be."""
    forged = [with_header(data, **{f: x}) for f in FRAME for x in (2.0**61, 2.0**-61, -1.0)]
    grid = number_of(data, Kind.GRID)
    forged += [with_chunk(data, grid, resolution=1), with_chunk(data, grid, rows=2**31)]
    forged += [with_level(data, 0, head_hidden=4096), with_level(data, 0, fuse_hidden=4096)]
    forged.append(with_level(data, 0, blocks=5))
    for text in BAD.values():
        raw = text.encode() if isinstance(text, str) else text
        pieces = taken(data)
        pieces.set_body(0, raw, raw=len(raw), rows=len(raw))
        forged.append(pieces.data())
    for tail in (b"\0", b"\3\0", b"\0" * 20):
        pieces = taken(data)
        level = max(pieces.blocks)
        pieces.set_stored(level, 0, deflate(pieces.raw_of(level, 0))[0] + tail)
        forged.append(pieces.data())
    return forged


def test_files_beyond_a_limit_meet_the_same_refusal(file: Path) -> None:
    forged = unusable(file.read_bytes())
    expected: list[str] = []
    for content in forged:
        with pytest.raises(FormatError) as caught:
            decode(content, "forged")
        expected.append(type(caught.value).__name__)
    assert opened(file, as_files(file, forged)) == expected


def test_changed_tables_with_right_checksums_meet_the_same_refusal(file: Path) -> None:
    """Every field of header and tables at its extremes, and small steps; Python is the oracle."""
    assert_same_refusals(file, 400)


def assert_same_refusals(file: Path, count: int) -> None:
    """Changes of single bytes of header and tables."""
    data = file.read_bytes()
    header = layout.Header._make(layout.HEADER.unpack_from(data))
    length = layout.index_bytes(header.levels, header.chunks)
    rng = np.random.default_rng(6)
    forged: list[bytes] = []
    for _ in range(count):
        changed = bytearray(data)
        place = int(rng.integers(8, length))
        changed[place] = int(rng.choice([0, 1, 127, 128, 255, (changed[place] + 1) % 256]))
        struct.pack_into("<I", changed, layout.offsets_of(layout.Header)["crc"], 0)
        crc = zlib.crc32(changed[:length])
        struct.pack_into("<I", changed, layout.offsets_of(layout.Header)["crc"], crc)
        forged.append(bytes(changed))
    answers = opened(file, as_files(file, forged))
    accepted = 0
    for content, answer in zip(forged, answers, strict=True):
        try:
            decode(content, "forged")
            expected = "accepted"
            accepted += 1
        except FormatError as error:
            expected = type(error).__name__
        assert answer == expected
    assert 0 < accepted < len(forged)
