"""A file that shows itself in a notebook: its viewer in a frame of the page, without a server."""

from pathlib import Path

import pytest

import gsynopsis as gs
from benchmarks.viewer.browser import MISSING, pinhole, pixels, psnr, visit
from gsynopsis.container import decode
from gsynopsis.runs import gsyn_file as files
from tests.viewer.bright import LEAST_DB, camera_of, drawn_by_cpu

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
INSIDE = "document.querySelector('iframe').contentWindow"
WHOLE = f"!!{INSIDE}.seen && {INSIDE}.seen.some((event) => event.name === 'complete')"


@pytest.mark.parametrize("level", [1, 3])
def test_the_frame_shows_the_finest_level_that_fits(
    bright: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, level: int
) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    with gs.open(bright) as file:
        monkeypatch.setattr(files, "EMBEDDED", file.levels[level].bytes)
        page = tmp_path / "notebook.html"
        page.write_text(f"<!doctype html><body>{file._repr_html_()}</body>", "utf-8")
    look = {"name": "picture", "script": f"{INSIDE}.picture({pinhole(camera)}, null)"}
    found = visit(page.as_uri(), tmp_path, [{"until": WHOLE}, look])
    assert psnr(pixels(found.results["picture"]), drawn_by_cpu(levels, camera)[level]) >= LEAST_DB
    assert not [line for line in found.said if line.startswith("pageerror")]


def test_a_file_of_which_nothing_fits_is_a_table_alone(
    bright: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "EMBEDDED", 10)
    with gs.open(bright) as file:
        assert file._repr_html_().startswith("<table>")
