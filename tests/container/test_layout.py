import subprocess
import sys
from pathlib import Path

import pytest

from gsynopsis.container import layout
from gsynopsis.container.layout import (
    BlockEntry,
    ChunkEntry,
    CodingId,
    Column,
    Header,
    Kind,
    LevelEntry,
)
from gsynopsis.container.values import TYPES
from scripts.codegen import markdown, typescript
from scripts.codegen_kernels import kernels_typescript, trimmed

ROOT = Path(__file__).parents[2]


def test_the_tables_of_the_format_page_are_those_of_the_layout() -> None:
    text = (ROOT / "docs" / "format.md").read_text()
    written = text.split("<!-- layout: generated, do not edit -->\n")[1]
    written = written.split("\n<!-- /layout -->")[0]
    assert written == markdown(), "run scripts/layout"


def test_the_viewers_constants_are_those_of_the_layout() -> None:
    text = (ROOT / "viewer" / "src" / "format" / "layout.gen.ts").read_text()
    assert text == typescript(), "run scripts/layout"
    for record in (Header, LevelEntry, ChunkEntry, BlockEntry):
        for name, offset in layout.offsets_of(record).items():
            assert f"  {name}: {{ offset: {offset}, " in text


def test_the_script_finds_nothing_to_do() -> None:
    line = [sys.executable, str(ROOT / "scripts" / "layout"), "--check"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "")


def test_record_sizes_are_those_of_version_1() -> None:
    sizes = (layout.HEADER.size, layout.LEVEL.size, layout.CHUNK.size, layout.BLOCK.size)
    assert sizes == (88, 48, 40, 56)
    assert layout.block_entry_bytes(3) == 72


@pytest.mark.parametrize("record", [Header, LevelEntry, ChunkEntry, BlockEntry])
def test_every_field_is_aligned_to_its_size(record: layout.Record) -> None:
    sizes = {"B": 1, "H": 2, "I": 4, "i": 4, "Q": 8, "f": 4, "d": 8, "8s": 8}
    fields = layout.fields_of(record)
    for name, offset in layout.offsets_of(record).items():
        assert offset % sizes[fields[name].code] == 0, name


def test_every_kind_and_coding_is_described_and_implemented() -> None:
    assert set(layout.KINDS) == set(Kind)
    assert set(layout.COLUMNS) == set(Column)
    assert set(layout.CODINGS) == set(CodingId) == set(TYPES)


def test_the_largest_tables_fit_the_first_16_kib() -> None:
    levels = int(layout.fields_of(Header)["levels"].high)
    chunks = int(layout.fields_of(Header)["chunks"].high)
    grids = int(layout.fields_of(LevelEntry)["grids"].high)
    assert layout.index_bytes(levels, chunks) <= layout.INDEX_BYTES_MAX
    assert 1 + levels * 4 + grids <= chunks


def test_the_viewer_has_the_kernels_of_the_package() -> None:
    path = ROOT / "viewer" / "src" / "render" / "webgpu" / "kernels.gen.ts"
    assert path.read_text("utf-8") == kernels_typescript(), "run scripts/layout"


def test_a_trimmed_kernel_keeps_its_tokens() -> None:
    text = "fn f(a: u32) -> f32 { // a > b\n  return - a  + (b - -c) / d;\n}"
    assert trimmed(text) == "fn f(a:u32)->f32{return - a +(b - -c)/d;}"
