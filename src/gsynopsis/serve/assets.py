"""The page's own files: in memory from the start, compressed, under a name made of their bytes."""

import base64
import gzip
import hashlib
import importlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response

from gsynopsis.errors import InputError, SettingError
from gsynopsis.serve.answer import LONG, precondition
from gsynopsis.serve.page import DATA
from gsynopsis.serve.refusal import SEALED

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
PACKED = {".html", ".js", ".mjs", ".css", ".json", ".wasm", ".svg"}
CODINGS = ("br", "gzip")
"""Content codings, the smaller one first."""
BEST_MAX = 1 << 18
"""Bytes that are worth the best of brotli, some 2 s for a megabyte; more is a long gallery."""
INDEX = "index.html"
FOREVER = f"{LONG}, immutable"
ASK = "no-cache"
"""Keep it, and ask each time whether it changed."""
BYTES_MAX = 64 << 20
"""Of all files of a viewer."""
SCRIPT = re.compile(r"<script\b([^>]*)>(.*?)</script>", re.DOTALL | re.IGNORECASE)
ORIGIN = re.compile(r"\*|https?://[A-Za-z0-9.\-\[\]:]+")
POLICY = (
    "default-src 'none'; base-uri 'none'; form-action 'none'; style-src 'unsafe-inline'; "
    "img-src 'self' data: blob:"
)


def _brotli() -> Callable[..., bytes] | None:
    """Its compressor; None where it is not installed."""
    try:
        return importlib.import_module("brotli").compress
    except ImportError:
        return None


@dataclass(frozen=True)
class Asset:
    """One file, ready to be sent.

    Attributes:
        data: Its bytes.
        media: Content type.
        policy: Content-Security-Policy.
        tag: Strong ETag of the plain form.
        packed: The same by content coding; none where that saves nothing.
    """

    data: bytes
    media: str
    policy: str
    tag: str
    packed: Mapping[str, bytes]

    def answer(self, asked: Headers, cache: str = ASK) -> Response:
        """200, 304 or 412; in the form that the client asks for."""
        coding = best_coding(asked.get("accept-encoding", ""), tuple(self.packed))
        tag = f'{self.tag[:-1]}-{coding}"' if coding else self.tag
        headers = {"etag": tag, "cache-control": cache, "content-security-policy": self.policy}
        if self.packed:
            headers["vary"] = "accept-encoding"
        status = precondition(asked, tag)
        if status == 304:
            return Response(status_code=304, headers=headers)
        if status == 412:
            return PlainTextResponse("another version is here", 412, headers)
        if coding:
            headers["content-encoding"] = coding
        body = self.packed[coding] if coding else self.data
        return Response(body, 200, headers, self.media)


@lru_cache(maxsize=16)
def asset_of(data: bytes, ending: str, policy: str = SEALED) -> Asset:
    """Compress bytes and name them."""
    # The same bytes give the same forms, so the tag says enough of all.
    tag = hashlib.sha256(policy.encode() + b"\0" + data).hexdigest()[:24]
    forms = {coding: _packed(data, coding) for coding in CODINGS if ending in PACKED}
    packed = {coding: form for coding, form in forms.items() if form and len(form) < len(data)}
    return Asset(data, TYPES[ending], policy, f'"{tag}"', packed)


def _packed(data: bytes, coding: str) -> bytes:
    """Bytes in a content coding; none where there is no code for it."""
    if coding == "gzip":
        return gzip.compress(data, 9, mtime=0)
    compress = _brotli()
    return compress(data, quality=11 if len(data) <= BEST_MAX else 5) if compress else b""


def best_coding(header: str, offered: Sequence[str] = CODINGS) -> str:
    """The coding that Accept-Encoding likes best, the first of equals; empty for the plain form.

    Not one that it likes less than the plain form (RFC 9110 §12.5.3).
    """
    weights: dict[str, float] = {}
    for word in header.lower().split(","):
        coding, *parameters = (part.strip() for part in word.split(";"))
        weight = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        exact = re.fullmatch(r"0(\.[0-9]{0,3})?|1(\.0{0,3})?", weight)
        weights[coding.removeprefix("x-")] = float(weight) if exact else 0.0

    def weight_of(coding: str) -> float:
        return weights.get(coding, weights.get("*", 0.0))

    liked = max(offered, key=weight_of, default="")
    enough = weight_of(liked) > 0 and weight_of(liked) >= weights.get("identity", 0.0)
    return liked if enough else ""


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

    def page(self, data: str = "") -> Asset | None:
        """The viewer's page.

        Args:
            data: An element to stand where the page has room for one.
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
        return asset_of(text.encode(), ".html", page_policy(text, self.frames))


def page_policy(text: str, frames: str) -> str:
    """Content-Security-Policy of a viewer's page: its own scripts, and scenes from anywhere.

    Workers are made of blobs and import the page's script; the kernel is WebAssembly.
    """
    inline = [code for attributes, code in SCRIPT.findall(text) if "src=" not in attributes]
    sums = dict.fromkeys(_sum(code) for code in inline if code.strip())
    scripts = " ".join(["'self'", "blob:", "'wasm-unsafe-eval'", *sums])
    return (
        f"{POLICY}; script-src {scripts}; worker-src 'self' blob:; "
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
