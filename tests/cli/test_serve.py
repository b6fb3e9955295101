"""`gsynopsis serve`: what of a folder becomes public, and what is printed."""

import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from urllib.error import HTTPError

import pytest

from gsynopsis.cli import main
from gsynopsis.runs.folder import RESULT_FILE, RUN_FILE

OTHERS = ("checkpoint.safetensors", RUN_FILE, "report.html", "scene.L0.gsyn", "deep/b.gsyn")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a run: what it holds is not looked into here."""
    (tmp_path / "deep").mkdir()
    for name in (RESULT_FILE, *OTHERS):
        (tmp_path / name).write_bytes(b"{}")
    return tmp_path


@contextmanager
def served(path: Path, *more: str) -> Generator[list[str]]:
    """The lines that `serve` prints."""
    line = [sys.executable, "-m", "gsynopsis", "serve", str(path), "--port", "0", *more]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline()]
        while "Ctrl-C" not in lines[-1]:
            lines.append(child.stdout.readline())
        try:
            yield [line.strip() for line in lines]
        finally:
            child.send_signal(signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
def test_a_runs_folder_shows_its_scene_and_publishes_nothing_else(run: Path) -> None:
    with served(run) as lines:
        root = lines[0].removesuffix(" shows it")
        assert lines[1:-1] == [root + RESULT_FILE]
        with urllib.request.urlopen(root + RESULT_FILE) as answer:
            assert answer.read() == b"{}"
        for name in OTHERS:
            with pytest.raises(HTTPError, match="404"):
                urllib.request.urlopen(root + name)
        with urllib.request.urlopen(root) as page:
            assert f'data-source="{RESULT_FILE}"'.encode() in page.read()


@pytest.mark.usefixtures("interruptible")
def test_printed_addresses_lead_to_the_files_whatever_their_names(tmp_path: Path) -> None:
    names = [b"a#b?c%20d.gsyn", b"\xff.gsyn", b"x\x1b[31m\n.gsyn"]
    for name in names:
        (tmp_path / os.fsdecode(name)).write_bytes(name)
    with served(tmp_path) as lines:
        assert len(lines) == 2 + len(names)
        found = set()
        for address in lines[1:-1]:
            with urllib.request.urlopen(address) as answer:
                found.add(answer.read())
        assert found == set(names)


@pytest.mark.parametrize(("host", "word"), [("127.0.0.1", False), ("0.0.0.0", True)])
@pytest.mark.usefixtures("interruptible")
def test_listening_beyond_this_machine_is_said(run: Path, host: str, word: bool) -> None:
    with served(run, "--host", host) as lines:
        assert any("other machines can reach it" in line for line in lines) == word
        # Nor does it import splats then.
        root = lines[0].removesuffix(" shows it").replace("0.0.0.0", "127.0.0.1")
        asked = urllib.request.Request(root, headers={"sec-fetch-site": "none"})
        with urllib.request.urlopen(asked) as page:
            assert (b"data-import" in page.read()) != word


@pytest.mark.parametrize(
    ("path", "more", "word"),
    [
        (RUN_FILE, [], "a folder or a .gsyn file"),
        (".", [], "train it first"),
        ("none.gsyn", [], "No such file"),
        ("ok.gsyn", ["--embed", "no origin"], "--embed"),
        ("ok.gsyn", ["--viewer", "."], "index.html"),
    ],
)
def test_what_cannot_be_served_is_one_line(
    tmp_path: Path, path: str, more: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / RUN_FILE).write_text(json.dumps({}))
    (tmp_path / "ok.gsyn").write_bytes(b"")
    words = [str(tmp_path) if extra == "." else extra for extra in more]
    assert main(["serve", str(tmp_path / path), "--port", "0", *words]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and word in said
