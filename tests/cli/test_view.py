"""`gsynopsis view`, and what `serve` shows at its root."""

import base64
import os
import re
from pathlib import Path

import httpx
import numpy as np
import pytest

from gsynopsis.cli import main
from gsynopsis.container import encode
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from tests.level_sets import make_level_set


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "a <b>.gsyn"
    path.write_bytes(encode(make_level_set(np.random.default_rng(0)), "compact"))
    return path


def test_a_page_holds_the_viewer_and_the_very_bytes_of_the_scene(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(scene)]) == 0
    page = scene.with_suffix(".html")
    assert str(page) in capsys.readouterr().out
    text = page.read_text(encoding="utf-8")
    found = re.search(r'id="gsynopsis-data"[^>]*>([^<]*)</script>', text)
    assert found is not None and base64.b64decode(found[1]) == scene.read_bytes()
    assert "<title>a &lt;b&gt;.gsyn</title>" in text
    assert "src=" not in text.split("<body>")[1].split("class ")[0]
    own = (FOLDER / "index.html").read_text(encoding="utf-8").count("</script>")
    assert text.count("</script>") == own + 2, "the page's own scripts, its workers', and the scene"


@pytest.mark.parametrize("command", ["view", "check", "info", "cut"])
def test_the_folder_of_a_run_does_as_well_as_its_file(scene: Path, command: str) -> None:
    run = scene.parent / "run"
    run.mkdir()
    scene.rename(run / "scene.gsyn")
    options = ["--all"] if command == "cut" else []
    assert main([command, str(run), *options]) == 0
    if command == "view":
        assert (run / "scene.html").is_file()
    assert main([command, str(scene.parent), *options]) == 2, "no run"


def test_a_page_beside_its_scene_names_it(scene: Path) -> None:
    page = scene.parent / "page.html"
    assert main(["view", str(scene), "--html", str(page), "--beside"]) == 0
    text = page.read_text(encoding="utf-8")
    assert 'data-source="a%20%3Cb%3E.gsyn"></script>' in text
    assert page.stat().st_size < 200_000


@pytest.mark.parametrize("extra", [["--beside", "--html", "{0}/sub/page.html"], ["--html", "{1}"]])
def test_a_page_where_it_cannot_be_is_refused_and_nothing_is_lost(
    scene: Path, extra: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = scene.read_bytes()
    words = [word.format(scene.parent, scene) for word in extra]
    assert main(["view", str(scene), *words]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert scene.read_bytes() == before


def test_a_damaged_scene_makes_no_page(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene.write_bytes(scene.read_bytes()[:-3])
    assert main(["view", str(scene)]) == 2
    assert "found" in capsys.readouterr().err
    assert not scene.with_suffix(".html").exists()


def test_a_name_that_is_no_text_makes_a_page_too(scene: Path) -> None:
    odd = scene.with_name(os.fsdecode(b"\xff#%.gsyn"))
    scene.rename(odd)
    for more in ([], ["--beside"]):
        page = odd.with_name("page.html")
        assert main(["view", str(odd), "--html", str(page), *more]) == 0
        text = page.read_text(encoding="utf-8")
        assert "<title>�#%.gsyn</title>" in text
        assert ('data-source="%FF%23%25.gsyn"' in text) == bool(more)


def test_the_server_shows_the_viewer_at_its_root(scene: Path) -> None:
    with serving(make_app(root_of(scene), viewer=FOLDER)) as address:
        page = httpx.get(address)
        assert page.headers["content-type"].startswith("text/html")
        name = re.search(r'src="([^"]+)"', page.text)
        assert name is not None
        code = httpx.get(f"{address}/{name[1]}")
        assert code.headers["content-type"].startswith("text/javascript")
        assert "gsynopsis-viewer" in code.text
