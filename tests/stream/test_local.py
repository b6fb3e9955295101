from pathlib import Path

import pytest

from gsynopsis.errors import SourceError
from gsynopsis.stream.local import FileSource
from gsynopsis.stream.source import PIECE, ByteSource

DATA = bytes(range(256)) * 600


@pytest.fixture
def source(tmp_path: Path) -> ByteSource:
    path = tmp_path / "a.bin"
    path.write_bytes(DATA)
    return FileSource(path)


@pytest.mark.parametrize("span", [(0, 1), (0, len(DATA)), (PIECE - 1, PIECE + 1), (5, 2 * PIECE)])
def test_pieces_are_the_range_in_order(source: ByteSource, span: tuple[int, int]) -> None:
    assert b"".join(source.read(*span)) == DATA[slice(*span)]


@pytest.mark.parametrize("span", [(-1, 4), (4, 4), (9, 4), (len(DATA), len(DATA) + 1)])
def test_a_range_outside_is_refused(source: ByteSource, span: tuple[int, int]) -> None:
    with pytest.raises(SourceError, match="range"):
        list(source.read(*span))


def test_a_range_ends_with_its_file(source: ByteSource) -> None:
    assert b"".join(source.read(len(DATA) - 3, len(DATA) + 9)) == DATA[-3:]


def test_a_missing_file_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.gsyn: found No such file"):
        list(FileSource(tmp_path / "none.gsyn").read(0, 1))
