import runpy
from pathlib import Path

import pytest

from gsynopsis.pack import layout
from gsynopsis.pack.codecs import CODINGS
from gsynopsis.pack.layout import ChunkEntry, CodingId, Header, Kind, LevelEntry

FORMAT = Path(__file__).parents[2] / "docs" / "format.md"


def test_the_tables_of_the_format_page_are_those_of_the_layout() -> None:
    text = FORMAT.read_text()
    written = text.split("<!-- layout: generated, do not edit -->\n")[1]
    written = written.split("\n<!-- /layout -->")[0]
    assert written == layout.tables(), "run python -m gsynopsis.pack.layout and paste it"


def test_the_module_prints_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(layout.__file__, run_name="__main__")
    assert capsys.readouterr().out == layout.tables() + "\n"


def test_record_sizes_are_those_of_version_1() -> None:
    assert (layout.HEADER.size, layout.LEVEL.size, layout.CHUNK.size) == (80, 40, 48)


@pytest.mark.parametrize("record", [Header, LevelEntry, ChunkEntry])
def test_every_field_is_aligned_to_its_size(record: layout.Record) -> None:
    sizes = {"B": 1, "H": 2, "I": 4, "Q": 8, "f": 4, "d": 8, "8s": 8}
    fields = layout.fields_of(record)
    for name, offset in layout.offsets_of(record).items():
        assert offset % sizes[fields[name].code] == 0, name


def test_every_kind_and_coding_is_described_and_implemented() -> None:
    assert set(layout.KINDS) == set(Kind)
    assert set(layout.CODING_MEANINGS) == set(CodingId) == set(CODINGS)


def test_the_largest_tables_fit_the_first_16_kib() -> None:
    levels = int(layout.fields_of(Header)["levels"].high)
    chunks = int(layout.fields_of(Header)["chunks"].high)
    grids = int(layout.fields_of(LevelEntry)["grids"].high)
    assert layout.index_bytes(levels, chunks) <= layout.INDEX_BYTES_MAX
    assert 1 + levels * (len(Kind) - 2) + grids <= chunks
