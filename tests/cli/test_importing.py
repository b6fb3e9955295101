"""`import` from the outside: up, levels, names and notes, and one line for what cannot be."""

import base64
import json
import re
import signal
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from inspect import signature
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from gsynopsis import cli
from gsynopsis.cli.importing import Import
from gsynopsis.container import read_gsyn
from gsynopsis.errors import SourceError
from gsynopsis.formats.readers.base import rows_of
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.jobs import import_splats as importing
from gsynopsis.records import PlainGaussians
from gsynopsis.scene.camera import look_at
from gsynopsis.stream.download import downloaded
from tests.formats.trees import commented, tree, write_tree

pytestmark = pytest.mark.usefixtures("few_tries")


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importing, "VIEWS_SIDE", 48)


def first(gaussians: PlainGaussians, count: int) -> bytes:
    return ply_bytes(rows_of(gaussians, np.arange(count)))


def up_after(path: Path, words: Sequence[str]) -> list[float]:
    assert cli.main(["import", str(path), "--quiet", "--levels", "1", "--overwrite", *words]) == 0
    return [float(v) for v in read_gsyn(path.with_suffix(".gsyn")).meta["up"].split()]


@pytest.mark.parametrize(
    ("words", "up"),
    [
        ([], [0, 0, 1]),
        (["--up", "+z"], [0, 0, 1]),
        (["--up", "-y"], [0, -1, 0]),
        (["--up", "X"], [1, 0, 0]),
        (["--up=-Z"], [0, 0, -1]),
        (["--up", "0", "-2", "0"], [0, -1, 0]),
        (["--up", "0", "-.6", "-0.8"], [0, -0.6, -0.8]),
    ],
)
def test_up_is_what_is_asked_for_else_what_the_file_says(
    words: list[str], up: list[float], tmp_path: Path
) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(commented(first(tree((0, 0, 1)), 20), "Vertical Axis: z"))
    assert up_after(path, words) == pytest.approx(up)


@pytest.mark.parametrize(
    "up", [["w"], ["0", "0"], ["0", "0", "0"], ["a", "b", "c"], ["nan", "0", "1"]]
)
def test_an_up_that_is_none_is_one_line(
    up: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_tree(tmp_path, "ply")
    assert cli.main(["import", str(path), "--quiet", "--up", *up]) == 2
    line = capsys.readouterr().err
    assert "--up" in line and line.count("\n") == 1
    assert not [*tmp_path.glob("*.gsyn")]


def test_the_command_and_the_library_have_the_same_defaults() -> None:
    library = signature(importing.import_splats).parameters
    command = {field.name: field.default for field in fields(Import)}
    for name in library.keys() & command.keys() - {"out"}:
        assert command[name] == library[name].default, name


@pytest.mark.parametrize(("count", "asked", "splats"), [(1, 4, [1]), (2, 8, [1, 2]), (3, 1, [3])])
def test_few_splats_make_as_many_levels_as_they_can(
    count: int, asked: int, splats: list[int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.ply").write_bytes(first(tree(), count))
    words = ["import", str(tmp_path / "a.ply"), "--json", "--steps", "2"]
    words += ["--levels", str(asked)]
    assert cli.main(words) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["splats"] == splats
    fewer = [note for note in made["notes"] if f"{len(splats)} of {asked} levels" in note]
    assert len(fewer) == (len(splats) < asked)
    assert not [note for note in made["notes"] if "levels" in note and note not in fewer]


@pytest.mark.parametrize(
    ("sizes", "splats"), [((5, 9), [5]), ((9, 9, 3), [3, 9]), ((12, 3, 7), [7, 12])]
)
def test_a_family_whose_levels_shrink_has_fewer(
    sizes: tuple[int, ...], splats: list[int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for lod, count in enumerate(sizes):
        (tmp_path / f"a_lod{lod}.ply").write_bytes(first(tree(), count))
    assert cli.main(["import", str(tmp_path / "a_lod0.ply"), "--json", "--steps", "0"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["splats"] == splats and "levels" in made["notes"][-1]


@pytest.mark.parametrize("name", [".", "..", "../scene"])
def test_a_folder_has_a_name_however_it_is_given(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("gaussforge")
    folder = write_tree(tmp_path / "scene", "ssog").parent
    (folder / "inner").mkdir()
    monkeypatch.chdir(folder / "inner" if name == ".." else folder)
    assert cli.main(["import", name, "--quiet", "--steps", "2"]) == 0
    assert (tmp_path / "scene.gsyn").is_file()


def test_an_empty_folder_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["import", ".", "--quiet"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_what_was_left_out_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = tree()
    given.means[7] = np.nan
    (tmp_path / "a.ply").write_bytes(ply_bytes(given))
    assert (
        cli.main(["import", str(tmp_path / "a.ply"), "--quiet", "--levels", "2", "--steps", "2"])
        == 0
    )
    out = capsys.readouterr().out
    assert "left out 1 of 60 splats" in out and "up is taken as 0 -1 0" in out


def test_an_environment_is_in_the_coarsest_level(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("gaussforge")
    path = write_tree(tmp_path / "scene", "ssog")
    meta = json.loads(path.read_text())
    meta["environment"] = "0_0/meta.json"
    path.write_text(json.dumps(meta))
    words = ["import", str(path), "--quiet", "--out", str(tmp_path / "a.gsyn"), "--overwrite"]
    assert cli.main([*words, "--steps", "0"]) == 0
    levels = read_gsyn(tmp_path / "a.gsyn")
    assert [level.anchors for level in levels.levels] == [90, 120]
    # Of trained levels the last has it; the others stand for it as for the rest.
    assert cli.main([*words, "--steps", "2"]) == 0
    levels = read_gsyn(tmp_path / "a.gsyn")
    assert levels.shared.stand_ins == 3
    assert levels.levels[-1].anchors - levels.first_shown(-1) == 120
    assert "levels of the file's own: not used" in capsys.readouterr().out


def test_cameras_beside_a_file_are_taken_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in 3DGS's folders; the orbit and the first view are then of these."""
    folder = tmp_path / "point_cloud" / "iteration_7"
    folder.mkdir(parents=True)
    path = write_tree(folder, "ply")
    (tmp_path / "cameras.json").write_text(json.dumps(rows_around(tree())))
    assert cli.main(["import", str(path), "--json", "--levels", "1"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert any(f"cameras: 6 of {tmp_path / 'cameras.json'}" in note for note in made["notes"])
    assert Path(made["sheet"]).read_bytes().startswith(b"\x89PNG")


def test_a_page_of_splats_lies_beside_them_and_the_import_is_not_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_tree(tmp_path, "ply")
    (tmp_path / "cameras.json").write_text(json.dumps(rows_around(tree())))
    before = {*tmp_path.iterdir()}
    assert cli.main(["view", str(path), "--beside"]) == 2
    advice = capsys.readouterr().err
    assert f"gsynopsis import {path}" in advice and "Traceback" not in advice
    assert cli.main(["view", str(path)]) == 0
    page = path.with_suffix(".html")
    assert {*tmp_path.iterdir()} - before == {page}
    found = re.search(r'id="gsynopsis-data"[^>]*>([^<]*)</script>', page.read_text("utf-8"))
    assert found is not None
    (tmp_path / "again.gsyn").write_bytes(base64.b64decode(found[1]))
    assert read_gsyn(tmp_path / "again.gsyn").levels[-1].anchors == len(tree())
    said = capsys.readouterr().out
    assert f"imported {path}: {len(tree())} splats" in said and str(page) in said
    assert not [*Path(tempfile.gettempdir()).glob(f"gsynopsis-*/{path.stem}.gsyn")]


@pytest.mark.usefixtures("interruptible")
def test_splats_are_served_as_levels_until_the_server_ends(tmp_path: Path) -> None:
    pytest.importorskip("uvicorn")
    path = write_tree(tmp_path, "ply")
    (tmp_path / "cameras.json").write_text(json.dumps(rows_around(tree())))
    line = [sys.executable, "-m", "gsynopsis", "serve", str(path), "--port", "0"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline()]
        while "Ctrl-C" not in lines[-1]:
            lines.append(child.stdout.readline())
        address = next(line for line in lines if line.strip().endswith(f"/{path.stem}.gsyn"))
        with urllib.request.urlopen(address.strip()) as answer:
            (tmp_path / "served.gsyn").write_bytes(answer.read())
        child.send_signal(signal.SIGINT)
    assert read_gsyn(tmp_path / "served.gsyn").levels[-1].anchors == len(tree())
    assert child.returncode in (0, 130)
    assert not [*Path(tempfile.gettempdir()).glob(f"gsynopsis-*/{path.stem}.gsyn")]


def test_cameras_of_another_scene_are_one_line_if_asked_for_and_else_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, other = write_tree(tmp_path, "ply"), tmp_path / "cameras.json"
    other.write_text(json.dumps(rows_around(tree(), 1e5)))
    assert cli.main(["import", str(path), "--quiet", "--cameras", str(other)]) == 2
    line = capsys.readouterr().err
    assert "nothing in view of 6 cameras" in line and line.count("\n") == 1
    assert not [*tmp_path.glob("*.gsyn"), *tmp_path.glob("*.png")]
    assert cli.main(["import", str(path), "--json", "--levels", "1"]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any("cameras beside it are not used" in note for note in notes)


def test_fog_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, given = tmp_path / "fog.ply", tree()
    path.write_bytes(ply_bytes(replace(given, logits=np.full_like(given.logits, -4.0))))
    assert cli.main(["import", str(path), "--quiet"]) == 2
    line = capsys.readouterr().err
    assert "only fog" in line and line.count("\n") == 1
    assert [each.name for each in tmp_path.iterdir()] == ["fog.ply"]


def rows_around(gaussians: PlainGaussians, off: float = 0.0) -> list[dict[str, object]]:
    """A cameras.json of six cameras around a scene, or so far from it."""
    middle = gaussians.means.mean(axis=0).astype(float) + off
    reach = 3 * float(np.abs(gaussians.means - gaussians.means.mean(axis=0)).max())
    rows: list[dict[str, object]] = []
    for turn in np.arange(6) * np.pi / 3:
        eye = middle + reach * np.array([np.cos(turn), -0.3, np.sin(turn)])
        w2c = look_at(eye, middle, np.array([0.0, -1.0, 0.0]))
        pose = {"position": eye.tolist(), "rotation": w2c[:3, :3].T.tolist()}
        rows.append({"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, **pose})
    return rows


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def host(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """A web server, and the folder it serves."""
    folder = tmp_path / "host"
    folder.mkdir()
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder)) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", folder
        server.shutdown()
        thread.join()


def test_an_address_is_downloaded_and_named_after_its_file(
    host: tuple[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address, folder = host
    (folder / "my scene.ply").write_bytes(first(tree(), 20))
    monkeypatch.chdir(tmp_path)
    asked = f"{address}/my%20scene.ply?signature=a/b.spz"
    assert cli.main(["import", asked, "--quiet", "--levels", "1"]) == 0
    assert read_gsyn(tmp_path / "my scene.gsyn").meta["scene"] == "my scene"
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("host", "my scene.cameras.png", "my scene.gsyn")
    ]


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("/none.ply", "404"),
        ("/", "no name of a file"),
        ("/lod-meta.json", "a list of other files"),
        ("/page.html", "a file that begins with"),
    ],
)
def test_an_address_of_no_splats_is_one_line_and_leaves_nothing(
    path: str,
    line: str,
    host: tuple[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    address, folder = host
    (folder / "page.html").write_text("<html>sign in</html>")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["import", f"{address}{path}", "--quiet"]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1 and "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir()] == ["host"]


def test_a_file_that_is_too_large_is_not_kept(host: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = host
    (folder / "a.ply").write_bytes(bytes(5000))
    with pytest.raises(SourceError, match="at most 4,999"):
        downloaded(f"{address}/a.ply", tmp_path / "to", lambda done, total: None, 4999)
    assert not [*(tmp_path / "to").iterdir()]


def test_a_host_that_is_not_there_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["import", "http://127.0.0.1:9/a.ply", "--quiet"]) in (1, 2)
    assert capsys.readouterr().err.count("\n") == 1
