"""Splats that a page sends to be imported: who may, how much, and what is left of it."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest

from gsynopsis.cli.dropped import COMMAND
from gsynopsis.serve import dropped
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving

FAKE = """
import os, pathlib, sys, time
log, given, made = map(pathlib.Path, sys.argv[1:])
text = given.read_text()
def note(line):
    with log.open("a") as file: file.write(line + "\\n")
note(f"begin {os.getpid()} {given}")
if text == "slow": time.sleep(0.3)
if text == "endless": time.sleep(600)
if text == "crash": os.abort()
if text == "wrong": sys.exit(f"reading 1/2\\ngsynopsis: {given}: found nothing")
made.write_text(f"scene of {text}")
note("end")
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log"
    path.touch()
    return path


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.fixture
def address(tmp_path: Path, log: Path, temporary: Path) -> Generator[str]:
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "a.gsyn").write_bytes(b"a")
    command = (sys.executable, "-c", FAKE, str(log))
    app = make_app(root_of(tmp_path / "scenes"), viewer=FOLDER, imports=command)
    with serving(app) as address:
        yield address
    assert not list(temporary.iterdir())


def post(address: str, text: str, name: str = "a.ply", **more: str) -> httpx.Response:
    headers = {"origin": address, **more}
    return httpx.post(f"{address}/import/{name}", content=text, headers=headers, timeout=60)


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def begun(log: Path) -> int:
    """Process of the first import, once it runs."""
    wait_for(lambda: log.read_text().count("\n") > 0)
    return int(log.read_text().split()[1])


def test_our_own_page_gets_a_scene_and_nothing_stays(address: str, temporary: Path) -> None:
    answer = post(address, "room")
    assert (answer.status_code, answer.text) == (200, "scene of room")
    assert answer.headers["x-content-type-options"] == "nosniff"
    wait_for(lambda: not list(temporary.iterdir()))


@pytest.mark.parametrize("site", ["none", "same-origin", "same-site", "cross-site", ""])
def test_a_page_says_so_unless_another_site_led_to_it(address: str, site: str) -> None:
    headers = {"sec-fetch-site": site} if site else {}
    text = httpx.get(address, headers=headers).text
    assert ("<body data-import>" in text) == (site not in ("", "cross-site"))


def test_nobody_else_may(address: str, log: Path) -> None:
    answers = [
        httpx.post(f"{address}/import/a.ply", content="room"),
        post(address, "room", origin="null"),
        post(address, "room", origin="https://evil.example"),
        post(address, "room", host="evil.example", origin="http://evil.example"),
    ]
    assert [answer.status_code for answer in answers] == [403] * 4
    assert httpx.put(f"{address}/import/a.ply", content="room").status_code == 405
    assert post(address, "room", "../a.gsyn").status_code == 405
    assert not log.read_text()


def test_a_server_that_imports_nothing_says_so(tmp_path: Path) -> None:
    with serving(make_app(root_of(tmp_path), viewer=FOLDER)) as address:
        assert post(address, "room").status_code == 405
        text = httpx.get(f"{address}/index.html", headers={"sec-fetch-site": "none"}).text
    assert "<body>" in text


def test_too_much_is_refused_announced_or_not(
    address: str, log: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dropped, "BYTES_MAX", 1 << 20)
    long = "x" * (1 << 21)
    pieces = (piece.encode() for piece in [long[: 1 << 19]] * 3)
    answers = [
        post(address, long),
        httpx.post(f"{address}/import/a.ply", content=pieces, headers={"origin": address}),
    ]
    for answer in answers:
        assert answer.status_code == 413
        assert (
            answer.text
            == "a.ply: found more than 0.000976562 GiB; `gsynopsis import a.ply` takes more"
        )
    assert not log.read_text()


@pytest.mark.parametrize(
    ("text", "line"),
    [("wrong", "a.ply: found nothing"), ("crash", "a.ply: the import ended without a word")],
)
def test_a_wrong_file_ends_in_one_line(address: str, text: str, line: str) -> None:
    answer = post(address, text)
    assert (answer.status_code, answer.text) == (400, line)


@pytest.mark.parametrize(
    "name",
    [
        "..%2F..%2Fout.ply",
        "%2Fout.ply",
        "..",
        ".",
        "",
        "%00",
        "x" * 5000,
        "%F0%9F%8C%B3" * 300,
        "%ff",
    ],
)
def test_a_name_leads_nowhere_else(address: str, log: Path, temporary: Path, name: str) -> None:
    host, port = address.removeprefix("http://").split(":")
    connection = HTTPConnection(host, int(port), timeout=60)
    connection.request("POST", f"/import/{name}", b"room", {"origin": address})
    answer = connection.getresponse()
    assert (answer.status, answer.read()) == (200, b"scene of room")
    connection.close()
    given = Path(log.read_text().split("\n")[0].split(" ", 2)[2])
    assert given.parent.parent == temporary


def test_one_is_imported_at_a_time_and_others_are_served_meanwhile(address: str, log: Path) -> None:
    with ThreadPoolExecutor(3) as pool:
        waits = [pool.submit(post, address, "slow") for _ in range(3)]
        begun(log)
        assert httpx.get(f"{address}/a.gsyn").content == b"a"
        assert [wait.result().status_code for wait in waits] == [200] * 3
    words = [line.split()[0] for line in log.read_text().splitlines()]
    assert words == ["begin", "end"] * 3


def test_an_import_ends_with_the_client_that_asked(
    address: str, log: Path, temporary: Path
) -> None:
    host, port = address.removeprefix("http://").split(":")
    connection = HTTPConnection(host, int(port))
    connection.request("POST", "/import/a.ply", b"endless", {"origin": address})
    process = begun(log)
    connection.close()
    wait_for(lambda: not runs(process) and not list(temporary.iterdir()))
    # One that goes away while it sends leaves nothing either, and the next has its turn.
    connection = HTTPConnection(host, int(port))
    connection.request("POST", "/import/a.ply", b"x", {"origin": address, "content-length": "9"})
    wait_for(lambda: bool(list(temporary.glob("*/a.ply"))))
    connection.close()
    assert post(address, "room").status_code == 200
    wait_for(lambda: not list(temporary.iterdir()))


def test_an_import_ends_with_the_server(tmp_path: Path, log: Path, temporary: Path) -> None:
    command = (sys.executable, "-c", FAKE, str(log))
    with ThreadPoolExecutor(1) as pool, serving(make_app(root_of(tmp_path), imports=command)) as at:
        asked = pool.submit(post, at, "endless")
        process = begun(log)
    assert asked.exception() is not None or asked.result().status_code >= 400
    wait_for(lambda: not runs(process) and not list(temporary.iterdir()))


def test_the_process_ends_with_a_killed_server_and_loads_nothing_of_the_folder(
    tmp_path: Path,
) -> None:
    marked = f"open({str(tmp_path / 'marked')!r}, 'w')"
    for name in ("gsynopsis", "torch", "numpy"):
        (tmp_path / f"{name}.py").write_text(marked)
    words = [*COMMAND, str(tmp_path / "numpy.py"), str(tmp_path / "out.gsyn")]
    child = subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path)
    _, said = child.communicate(timeout=120)  # its input ends at once
    assert (child.returncode, said) == (1, b"")
    assert not (tmp_path / "marked").exists()
