"""The built viewer: where it lies, and a page that holds it and a scene in one file."""

import base64
import html
import re
from pathlib import Path

from gsynopsis.errors import InputError

FOLDER = Path(__file__).parent.parent / "viewer_dist"
"""index.html and its scripts, built from viewer/ by `npm run build`."""
VIEWER, DECODER = "gsynopsis-viewer.js", "gsynopsis-decoder.js"
"""Modules of the page and of its workers; each loads others after the first image."""
MODULE = re.compile(r'<script type="module" id="gsynopsis-viewer-module" src="[^"]+"></script>')
IMPORT = re.compile(r'\Aimport\{([^}]*)\}from"\./([\w-]+\.js)";')
EXPORT = re.compile(r"export\{([^}]*)\};\s*\Z")
DEFERRED = re.compile(r"\bimport\(`\./([\w-]+\.js)`\)")
DATA = "<!-- data -->"
"""Stands in the page where the scene, or its address, goes."""
WEBGPU = "gsynopsis-webgpu.js"
WITHOUT = """(text=>({openBackend(){
console.warn("gsynopsis: "+text);
return{make(canvas,told){told.notice(text)}};
}}))("WebGPU was asked for, and a page in one file is without it: WebGL 2 draws.")"""
"""Module that pages in one file are without, as few ask for it, and what they have in its place."""
FIRST_MAX = 1 << 20
"""Bytes that a page asks for at most before its script is there."""


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
    embedded = base64.b64encode(data).decode() if data is not None else ""
    element = carrier(name, source, embedded)
    # "</script" would end the element; in JavaScript text `<\/script` means the same.
    viewer, decoder = (
        one_script(FOLDER / part).replace("</script", r"<\/script") for part in (VIEWER, DECODER)
    )
    scripts = (
        f'<script type="module" id="gsynopsis-viewer-module">{viewer}</script>\n'
        f'<script type="text/plain" id="gsynopsis-worker">{decoder}</script>'
    )
    text = text[: found.start()] + scripts + text[found.end() :]
    title = f"<title>{html.escape(name)}</title>"
    return text.replace(DATA, element).replace("<title>gsynopsis</title>", title)


def one_script(path: Path) -> str:
    """A built module and those that it loads later, as one script that imports nothing.

    Each module becomes a function, so that their minified names stay apart; the later ones run
    once, when the first asks for them. A page opened from the disk can load no module beside
    itself. It draws by WebGL 2 alone.

    Raises:
        InputError: the modules are not of the form in which the viewer is built.
    """
    code, exported = _without_exports(path, path.read_text(encoding="utf-8"))
    names = list(dict.fromkeys(DEFERRED.findall(code)))
    if not names:
        raise _strange(path)
    later = "".join(_deferred(path, path.with_name(name), i) for i, name in enumerate(names))
    code = DEFERRED.sub(
        lambda found: f"Promise.resolve().then(gsynopsisDeferred{names.index(found[1])})", code
    )
    script = (
        f'(()=>{{"use strict";const gsynopsisShared={{}};{later}{code}\n'
        f"Object.assign(gsynopsisShared,{{{exported}}})}})();"
    )
    # A plain script has no address; the page's own is that of a module.
    return script if path.name == VIEWER else script.replace("import.meta.url", '""')


def _deferred(path: Path, later: Path, number: int) -> str:
    """A function that runs a later module once, with what the first one exports."""
    if later.name == WEBGPU:
        return f"const gsynopsisDeferred{number}=()=>({WITHOUT});"
    text = later.read_text(encoding="utf-8")
    imported = IMPORT.match(text)
    if imported is None or imported[2] != path.name:
        raise _strange(later)
    names = _pairs(imported[1], "{0}:{1}")
    body, given = _without_exports(later, text[imported.end() :])
    return (
        f"let gsynopsisLoaded{number};const gsynopsisDeferred{number}=()=>"
        f"gsynopsisLoaded{number}??=(()=>{{"
        f"const{{{names}}}=gsynopsisShared;{body}\nreturn{{{given}}}}})();"
    )


def _without_exports(path: Path, code: str) -> tuple[str, str]:
    """A module's code without its last statement, and the exports, as members of an object."""
    found = EXPORT.search(code)
    if found is None or re.search(r"\b(import|export)[{*]", code[: found.start()]):
        raise _strange(path)
    return code[: found.start()], _pairs(found[1], "{1}:{0}")


def _pairs(names: str, form: str) -> str:
    """`a as b,c` with each name and its alias put into a form."""
    pairs = (name.split(" as ") for name in names.split(","))
    return ",".join(form.format(pair[0], pair[-1]) for pair in pairs)


def _strange(path: Path) -> InputError:
    return InputError(path, found="another script", expected="the built viewer")


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
