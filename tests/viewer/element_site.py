"""Somebody's page with the element in it, beside a scene."""

import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.viewer.node import SCRIPTS
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving


@contextmanager
def site(folder: Path, scene: Path, page: str) -> Generator[str]:
    """A server of a page that loads `gsynopsis-viewer.js`, and of a scene; gives its address."""
    place = folder / "site"
    place.mkdir(exist_ok=True)
    for script in SCRIPTS:
        shutil.copy(script, place)
    (place / "index.html").write_text(page)
    with serving(make_app(root_of(scene), viewer=place)) as address:
        yield address
