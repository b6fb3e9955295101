"""The page's own files: in memory from the start, under a name made of their bytes."""

import base64
import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.staticfiles import StaticFiles

from gsynopsis.errors import InputError, SettingError
from gsynopsis.serve.page import DATA

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".webp": "image/webp",
    ".ico": "image/x-icon",
}
"""Files of a page by ending; others are not served."""
INDEX = "index.html"
LONG = "public, max-age=31536000"
"""Scenes: a year. A client that goes on after a change notices it by the ETag."""
FOREVER = f"{LONG}, immutable"
ASK = "no-cache"
"""Keep it, and ask each time whether it changed."""
BYTES_MAX = 64 << 20
"""Most bytes of all files of a viewer."""
SCRIPT = re.compile(r"<script\b([^>]*)>(.*?)</script>", re.DOTALL | re.IGNORECASE)
ORIGIN = re.compile(r"\*|https?://[A-Za-z0-9.\-\[\]:]+")
STYLE = re.compile(r"<style>(.*?)</style>", re.DOTALL)
STYLED = re.compile(r"<style\s|\sstyle=", re.IGNORECASE)
POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; img-src 'self' data: blob:"


@dataclass(frozen=True)
class Asset:
    """One file, ready to be sent.

    Attributes:
        data: Its bytes.
        media: Content type.
        policy: Content-Security-Policy; empty for that of every answer.
        tag: Strong ETag.
    """

    data: bytes
    media: str
    policy: str
    tag: str

    def answer(self, static: StaticFiles, asked: Headers, cache: str = ASK) -> Response:
        """200, or 304 for a client that has these bytes."""
        headers = {"etag": self.tag, "cache-control": cache}
        if self.policy:
            headers["content-security-policy"] = self.policy
        response = Response(self.data, 200, headers, self.media)
        if static.is_not_modified(response.headers, asked):
            # With the policy: a browser replaces what it has kept of it.
            return Response(status_code=304, headers=headers)
        return response


def asset_of(data: bytes, ending: str, policy: str = "") -> Asset:
    """Name bytes by their checksum."""
    tag = hashlib.sha256(policy.encode() + b"\0" + data).hexdigest()[:24]
    return Asset(data, TYPES[ending], policy, f'"{tag}"')


@dataclass(frozen=True)
class Site:
    """The files of a viewer.

    Attributes:
        files: By name below the viewer's folder.
        version: Names the very bytes of all of them; scripts are served below it for ever.
        frames: Who may show the page in a frame, as in Content-Security-Policy.
    """

    files: Mapping[str, Asset] = field(default_factory=dict[str, Asset])
    version: str = ""
    frames: str = "'self'"

    def find(self, name: str) -> tuple[Asset, str] | None:
        """A file, and how long it may be kept; the page itself is made by `page`."""
        folder, _, rest = name.partition("/")
        if self.version and folder == self.version and rest in self.files and rest != INDEX:
            return self.files[rest], FOREVER
        return (self.files[name], ASK) if name in self.files else None

    def page(self, data: str = "", *, may: Sequence[str] = ()) -> Asset | None:
        """The viewer's page.

        Args:
            data: An element to stand where the page has room for one.
            may: What the server does for it: `edit`, `import`.
        """
        index = self.files.get(INDEX)
        if index is None:
            return None
        text = index.data.decode("utf-8", "replace")
        for name in self.files:
            for word in (f'src="{name}"', f'href="{name}"'):
                text = text.replace(word, word.replace('="', f'="{self.version}/'))
        if data:
            text = text.replace(DATA, data)
        if may:
            words = "".join(f" data-{word}" for word in may)
            text = text.replace("<body>", f"<body{words}>", 1)
        return asset_of(text.encode(), ".html", page_policy(text, self.frames))


def plain_policy(text: str) -> str:
    """Content-Security-Policy of a page without scripts: its own styles alone."""
    styles = " ".join(dict.fromkeys(_sum(code) for code in STYLE.findall(text))) or "'none'"
    if STYLED.search(text):  # somebody else's viewer: attributes have no sums
        styles = "'unsafe-inline'"
    return f"{POLICY}; style-src {styles}"


def page_policy(text: str, frames: str) -> str:
    """Content-Security-Policy of a viewer's page: its own scripts, and scenes from anywhere.

    Workers are made of blobs and import the page's script; the kernel is WebAssembly.
    """
    inline = [code for attributes, code in SCRIPT.findall(text) if "src=" not in attributes]
    sums = dict.fromkeys(_sum(code) for code in inline if code.strip())
    scripts = " ".join(["'self'", "blob:", "'wasm-unsafe-eval'", *sums])
    return (
        f"{plain_policy(text)}; script-src {scripts}; worker-src 'self' blob:; "
        f"connect-src * data: blob:; frame-ancestors {frames}"
    )


def _sum(code: str) -> str:
    # As a parser has it: line ends are single.
    plain = code.replace("\r\n", "\n").replace("\r", "\n").encode()
    return f"'sha256-{base64.b64encode(hashlib.sha256(plain).digest()).decode()}'"


def read_site(folder: Path, embed: Sequence[str] = ()) -> Site:
    """A built viewer from its folder.

    Args:
        folder: With an `index.html`.
        embed: Origins whose pages may show it in a frame, `*` for all; its own may always.

    Raises:
        InputError: it has no index.html, or is too large.
        SettingError: one of `embed` is no origin.
    """
    for origin in embed:
        if not ORIGIN.fullmatch(origin):
            expected = "* or an origin such as https://example.org"
            raise SettingError("--embed", found=repr(origin), expected=expected)
    files: dict[str, Asset] = {}
    total = 0
    for path in sorted(_walk(folder)):
        total += path.stat().st_size
        if total > BYTES_MAX:
            expected = f"at most {BYTES_MAX} bytes of pages and scripts"
            raise InputError(folder, found="more", expected=expected)
        name = path.relative_to(folder).as_posix()
        files[name] = asset_of(path.read_bytes(), path.suffix.lower())
    if INDEX not in files:
        advice = "run `npm run build` in viewer/"
        raise InputError(folder, found=f"no {INDEX}", expected="a built viewer", advice=advice)
    tags = "".join(f"{name}{asset.tag}" for name, asset in files.items())
    version = "v-" + hashlib.sha256(tags.encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return Site(files, version, " ".join(["'self'", *embed]))


def _walk(folder: Path) -> list[Path]:
    """Files with an ending of pages, none of them hidden or a link."""
    found: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        paths = (Path(place) / name for name in names if not name.startswith("."))
        found += [p for p in paths if p.suffix.lower() in TYPES and not p.is_symlink()]
    return found
