"""Regular files are opened; whatever else has a name is refused at once."""

import os
import socket
from pathlib import Path

import pytest

from gsynopsis.errors import InputError, SceneError
from gsynopsis.regular import open_regular, read_regular


def test_a_file_and_a_link_to_it_are_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"bytes")
    (tmp_path / "link").symlink_to("file")
    assert read_regular(tmp_path / "file") == read_regular(str(tmp_path / "link")) == b"bytes"
    with open_regular(tmp_path / "file") as file:
        assert file.read(2) == b"by" and file.seek(0) == 0


def test_what_is_no_regular_file_is_named_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "nowhere").symlink_to("missing")
    (tmp_path / "folder").mkdir()
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(tmp_path / "socket"))
    kinds = {
        tmp_path / "pipe": "a pipe",
        tmp_path / "link": "a pipe",
        tmp_path / "folder": "a folder",
        tmp_path / "socket": "a socket",
        Path("/dev/zero"): "a device",
        tmp_path / "nowhere": "No such file or directory",
        tmp_path / "a" / "b": "No such file or directory",
        tmp_path / ("n" * 300): "File name too long",
    }
    for path, kind in kinds.items():
        with pytest.raises(SceneError) as caught:
            open_regular(path, SceneError, "points")
        assert str(caught.value) == f"{path}: found {kind}, expected points"
    with pytest.raises(InputError, match=r"a\\x00b': found embedded null"):
        open_regular(tmp_path / "a\0b")


def test_a_pipe_with_somebody_who_writes_is_refused_as_well(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = os.open(tmp_path / "pipe", os.O_RDWR)
    try:
        with pytest.raises(InputError, match="found a pipe"):
            read_regular(tmp_path / "pipe")
    finally:
        os.close(writer)


def test_a_file_larger_than_it_may_be_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match=r"found 1,099,511,627,776 bytes, expected at most 1,000"):
        read_regular(tmp_path / "sparse", most=1000)
    (tmp_path / "fits").write_bytes(bytes(1000))
    assert len(read_regular(tmp_path / "fits", most=1000)) == 1000
