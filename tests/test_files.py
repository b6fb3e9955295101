"""Files are made anew and whole, and only regular ones are read."""

import errno
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from gsynopsis import files
from gsynopsis.container.writer import publish as publish_bytes
from gsynopsis.errors import InputError, SceneError, SpaceError
from gsynopsis.files import (
    clear_drafts,
    inner_folder,
    open_regular,
    publish,
    published,
    read_regular,
)

KILLED = """
import os, sys
from pathlib import Path
from gsynopsis.files import published
with published(Path(sys.argv[1])) as draft:
    draft.write_text("half")
    draft.with_name(".tmpAbC123").write_text("what a library writes beside")
    os.kill(os.getpid(), 9)
"""


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "outside" / "secret.txt"
    path.parent.mkdir()
    path.write_text("mine")
    return path


@pytest.mark.parametrize("write", [publish, lambda path, data: publish_bytes(data, path)])
def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path: Path, secret: Path, write) -> None:
    for name in ("run.json", "scene.gsyn", "metrics.csv"):
        target = tmp_path / name
        target.symlink_to(secret)
        write(target, b"new")
        assert target.read_bytes() == b"new" and not target.is_symlink()
        os.unlink(target)
        os.link(secret, target)
        write(target, b"new")
    assert secret.read_text() == "mine"


def test_links_at_names_of_drafts_are_not_written_through(tmp_path: Path, secret: Path) -> None:
    pid = os.getpid()
    for name in (f".a.{pid}.json", f".a.json.{pid}.tmp", "a.json.tmp", "a.tmp"):
        (tmp_path / name).symlink_to(secret)
    publish(tmp_path / "a.json", "new")
    assert secret.read_text() == "mine" and (tmp_path / "a.json").read_text() == "new"


@pytest.mark.parametrize("name", ["checkpoint.safetensors", "é" * 120, "a.b.99.c"])
def test_what_a_kill_left_goes_when_the_file_is_written_again(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    (tmp_path / f".{name[:30]}x.1.abcdefgh.draft").mkdir()
    line = [sys.executable, "-c", KILLED, str(path)]
    assert subprocess.run(line).returncode == -9
    assert not path.exists() and len(list(tmp_path.iterdir())) == 2
    publish(path, "whole")
    left = {p.name for p in tmp_path.iterdir()} - {f".{name[:30]}x.1.abcdefgh.draft"}
    assert left == {name} and path.read_text() == "whole"


def test_drafts_of_running_processes_and_links_stay(tmp_path: Path, secret: Path) -> None:
    kept = (f".a.{os.getppid()}.abcdefgh.draft", ".notes.draft", ".b.1.abcdefgh.drafts")
    for name in kept:
        (tmp_path / name).mkdir()
    (tmp_path / ".c.999999999.abcdefgh.draft").symlink_to(secret.parent)
    clear_drafts(tmp_path)
    assert {*kept, ".c.999999999.abcdefgh.draft"} <= {p.name for p in tmp_path.iterdir()}
    assert secret.exists()


def test_what_this_process_is_making_stays(tmp_path: Path) -> None:
    left = tmp_path / f".a.json.{os.getpid()}.abcdefgh.draft"
    left.mkdir()
    with published(tmp_path / "a.json") as first:
        first.write_text("first")
        publish(tmp_path / "a.json", "second")
        clear_drafts(tmp_path)
        assert first.exists() and not left.exists()
    assert (tmp_path / "a.json").read_text() == "first"


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_names_the_file(tmp_path: Path, code: int) -> None:
    with pytest.raises(SpaceError, match=r"a\.png: disk: found .*; free some space"):  # noqa: SIM117
        with published(tmp_path / "a.png"):
            raise OSError(code, os.strerror(code))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("links", [True, False])
def test_only_regular_files_are_read(tmp_path: Path, secret: Path, links: bool) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "device").symlink_to("/dev/zero")
    for name, found in (("pipe", "a pipe"), ("folder", "a folder")):
        with pytest.raises(InputError, match=f"{name}: found {found}, expected a regular file"):
            open_regular(tmp_path / name, links=links)
    with pytest.raises(InputError, match="found a device" if links else "found a link"):
        open_regular(tmp_path / "device", links=links)
    with pytest.raises(InputError, match=r"NUL|null"):
        open_regular(tmp_path / "a\0b", links=links)
    with open_regular(secret, links=links) as file:
        assert file.read() == b"mine"
    with pytest.raises(InputError, match="found 4 bytes, expected at most 3"):
        files.read_regular(secret, 3)


def test_a_folder_of_a_run_is_no_link(tmp_path: Path, secret: Path) -> None:
    (tmp_path / "photos").symlink_to(secret.parent)
    with pytest.raises(InputError, match="photos: found a link, expected a folder; remove it"):
        inner_folder(tmp_path, "photos")
    assert inner_folder(tmp_path, "board").is_dir()


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
