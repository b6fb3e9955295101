"""The pages as a site: builds without a warning, and asks nobody on the network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="mkdocs is not installed: extra 'docs'")
pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed: extra 'docs'")

ROOT = Path(__file__).parent.parent
LOADED = re.compile(r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//|<link[^>]*stylesheet[^>]*//')


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=ROOT, env=quiet, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return out


def test_every_page_is_in_the_site(site: Path) -> None:
    pages = {p.relative_to(ROOT / "docs").with_suffix("") for p in (ROOT / "docs").rglob("*.md")}
    assert pages <= {p.relative_to(site).with_suffix("") for p in site.rglob("*.html")}


def test_the_api_has_docstrings_of_functions_whose_names_are_also_rooms(site: Path) -> None:
    page = (site / "api.html").read_text("utf-8")
    for name in ("train.train", "pack.pack", "evaluate.evaluate"):
        _, found, after = page.partition(f'id="gsynopsis.jobs.{name}"')
        assert found and "Examples" in after.partition("<h3")[0]


def test_readers_load_nothing_from_elsewhere(site: Path) -> None:
    assert not [page.name for page in site.rglob("*.html") if LOADED.search(page.read_text())]
