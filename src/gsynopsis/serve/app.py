"""The application: scenes with ranges, a page that shows them, a list of them."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote, unquote_to_bytes

import anyio
import anyio.to_thread
from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gsynopsis.serve.assets import ASK, INDEX, LONG, Asset, Site, read_site
from gsynopsis.serve.dropped import PLACE, importer
from gsynopsis.serve.edit import SUFFIX, Edits
from gsynopsis.serve.files import ENDING, Root, address_of, shown_name
from gsynopsis.serve.gallery import Card, Catalogue, gallery, listing
from gsynopsis.serve.page import carrier
from gsynopsis.serve.throttle import Throttle
from gsynopsis.stream.virtual import Link

EXPOSED = ["Accept-Ranges", "Content-Length", "Content-Range", "ETag", "Last-Modified"]
ASKED = ["Range", "If-Range", "If-None-Match", "If-Match", "Authorization"]
SECURITY_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "content-security-policy": "default-src 'none'",
}
"""Content-Security-Policy of every answer that has none of its own."""
ANNOTATIONS = f"{ENDING}{SUFFIX}"
"""End of the addresses at which a scene's annotations are put."""
OURS = {"none", "same-origin", "same-site"}
"""Who leads to a page, as a browser tells: a person, or a page of this machine."""
STATIC = StaticFiles()
"""Starlette's answers to conditions; it has no folder, since names are ours to check."""
Report = Callable[[], object]
"""Makes something that can be said in JSON."""


class Server:
    """Answers GET and HEAD without a body, and other sites' preflight requests for scenes."""

    def __init__(
        self,
        root: Root,
        site: Site,
        reports: Mapping[str, Report],
        edits: Edits | None,
        imports: ASGIApp | None,
    ) -> None:
        """Scenes of a root, shown by a viewer if the site has one; reports by name."""
        self._edits, self._imports = edits, imports
        self._root, self._site, self._reports = root, site, reports
        self._catalogue = Catalogue(root)
        # A thread of its own: a large folder must not hold up those that read files.
        self._looker = anyio.CapacityLimiter(1)
        self._pages = GZipMiddleware(self._page)
        self._scenes = CORSMiddleware(
            self._scene,
            allow_origins=["*"],
            allow_methods=["GET", "HEAD"],
            allow_headers=ASKED,
            expose_headers=EXPOSED,
            max_age=86400,
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            return
        app: ASGIApp = self._scenes if name_of(scope).endswith(ENDING) else self._pages
        method, headers = scope["method"], Headers(scope=scope)
        asks = "origin" in headers and "access-control-request-method" in headers
        preflight = asks and method == "OPTIONS" and app is self._scenes
        name = name_of(scope)
        if method == "PUT" and self._edits is not None and name.endswith(ANNOTATIONS):
            await self._edits.put(name, scope, receive, with_security_headers(send))
            return
        if method == "POST" and self._imports is not None and name.startswith(PLACE):
            await self._imports(scope, receive, with_security_headers(send))
            return
        if method not in {"GET", "HEAD"} and not preflight:
            more = {"allow": "GET, HEAD", "connection": "close"}
            app = PlainTextResponse("GET or HEAD", 405, more)
        elif has_body(headers):
            app = PlainTextResponse("a body is refused", 400, {"connection": "close"})
        await app(scope, receive, with_security_headers(send))

    async def _scene(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = self._root.find(name_of(scope))
        try:
            state = path.stat() if path else None
        except OSError:  # it has just been removed
            state = None
        if path is None or state is None:
            answer: Response = PlainTextResponse("not found", 404)
        else:
            answer = STATIC.file_response(path, state, scope)
            answer.headers["cache-control"] = LONG
        await answer(scope, receive, send)

    async def _page(self, scope: Scope, receive: Receive, send: Send) -> None:
        name, asked = name_of(scope), Headers(scope=scope)
        found = self._site.find(name)
        if name == "listing.json":
            cards, _ = await self._look()
            answer: Response = JSONResponse(listing(cards), headers={"cache-control": ASK})
        elif name in self._reports:
            report = self._reports[name]()
            answer = JSONResponse(report, headers={"cache-control": "no-store"})
        elif not name or name == INDEX:
            content = bool(name) or "content" in QueryParams(scope["query_string"])
            led = asked.get("sec-fetch-site") not in OURS
            answer = (await self._index(content, led)).answer(STATIC, asked)
        elif found is not None:
            asset, cache = found
            answer = asset.answer(STATIC, asked, cache)
        else:
            answer = PlainTextResponse("not found", 404)
        await answer(scope, receive, send)

    async def _index(self, content: bool, led: bool) -> Asset:
        """The viewer with the scene that the address names, or the only one; else the gallery.

        Another site that led here may have named a file, which is then not imported.
        """
        may = {"edit": self._edits is not None, "import": self._imports is not None and not led}
        words = [word for word, is_so in may.items() if is_so]
        page = self._site.page(may=words) if content else None
        if page is not None:
            return page
        cards, count = await self._look()
        if len(cards) == 1 or self._root.only:
            page = self._site.page("".join(map(carrier_of, cards)), may=words)
        viewer, frames = bool(self._site.files), self._site.frames
        return page or gallery(cards, count, viewer=viewer, frames=frames)

    async def _look(self) -> tuple[list[Card], int]:
        return await anyio.to_thread.run_sync(self._catalogue.look, limiter=self._looker)


def make_app(
    root: Root,
    *,
    viewer: Path | None = None,
    link: Link | None = None,
    embed: Sequence[str] = (),
    reports: Mapping[str, Report] | None = None,
    edit: bool = False,
    imports: Sequence[str] = (),
) -> ASGIApp:
    """The server's application.

    Args:
        root: What may be served.
        viewer: Folder of the built viewer, read now; without one `/` is a plain page.
        link: Shape all answers like this, None for as fast as it goes.
        embed: Origins whose pages may show ours in a frame.
        reports: Made anew for each request, by the name under which they are found.
        edit: Save annotations that our own pages make; else nothing is ever written.
        imports: Command that makes a scene of splats which our own pages send, see `importer`;
            empty for none.

    Raises:
        InputError: the viewer's folder holds none.
        SettingError: an origin is none.
    """
    edits = Edits(root) if edit else None
    site = read_site(viewer, embed) if viewer else Site()
    server = Server(root, site, reports or {}, edits, importer(imports) if imports else None)
    return server if link is None else Throttle(server, link)


def carrier_of(card: Card) -> str:
    """The element in which a page finds a scene; it asks for the base first, exactly."""
    base = card.levels[0][0] if card.levels else 0
    return carrier(shown_name(card.name), address_of(card.name), first=base)


def name_of(scope: Scope) -> str:
    """The name that a request asks for, byte for byte as the file system has it."""
    raw = scope.get("raw_path") or quote(scope["path"]).encode()
    return os.fsdecode(unquote_to_bytes(raw)).removeprefix("/")


def has_body(headers: Headers) -> bool:
    """The request announces a body."""
    return "transfer-encoding" in headers or headers.get("content-length", "0").strip("0 ") != ""


def with_security_headers(send: Send) -> Send:
    """The same `send`, for answers that then have all of `SECURITY_HEADERS`."""

    async def sealed(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in SECURITY_HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sealed
