"""The built viewer: where it lies, and a page that holds it and a scene in one file."""

import base64
import html
import re
from pathlib import Path

from gsynopsis.errors import InputError

FOLDER = Path(__file__).parent.parent / "viewer_dist"
"""index.html and its scripts, built from viewer/ by `npm run build`."""
WHOLE = "gsynopsis-viewer.js"
"""All of the viewer in one script."""
MODULE = re.compile(r'<script type="module" id="gsynopsis-viewer-module" src="[^"]+"></script>')
DATA = "<!-- data -->"
FIRST_MAX = 1 << 20
"""Bytes that a page asks for at most before its script is there."""
"""Stands in the page where the scene, or its address, goes."""


def single_page(name: str, data: bytes | None, source: str = "") -> str:
    """A page that needs no server: the viewer's code inside, the scene inside or beside it.

    Args:
        name: What the scene is called, for the title.
        data: The whole .gsyn file, embedded as base64; None to load `source`.
        source: Address of the file, as seen from the page.

    Raises:
        InputError: the viewer has not been built.
    """
    index = FOLDER / "index.html"
    if not index.is_file():
        raise InputError(index, found="no viewer", advice="run `npm run build` in viewer/")
    text = index.read_text(encoding="utf-8")
    found = MODULE.search(text)
    if found is None or DATA not in text:
        raise InputError(index, found="another page", expected="the built viewer")
    # "</script" would end the element; in JavaScript text `<\/script` means the same.
    code = (FOLDER / WHOLE).read_text(encoding="utf-8").replace("</script", r"<\/script")
    embedded = base64.b64encode(data).decode() if data is not None else ""
    element = carrier(name, source, embedded)
    module = f'<script type="module" id="gsynopsis-viewer-module">{code}</script>'
    text = text[: found.start()] + module + text[found.end() :]
    title = f"<title>{html.escape(name)}</title>"
    return text.replace(DATA, element).replace("<title>gsynopsis</title>", title)


def carrier(name: str, source: str, embedded: str = "", first: int = 0) -> str:
    """The element in which a page finds its scene.

    Args:
        name: What the scene is called.
        source: Address of the file, as seen from the page.
        embedded: The file as base64, empty to load it from `source`.
        first: Bytes that show something, asked for before the page's script is there; 0 leaves
            their number to the page.
    """
    asked = f' data-first="{first}"' if 0 < first <= FIRST_MAX else ""
    return (
        f'<script type="text/plain" id="gsynopsis-data" data-name="{html.escape(name)}" '
        f'data-source="{html.escape(source)}"{asked}>{embedded}</script>'
    )
