"""The application: scenes with ranges, a page that shows them, a list of them."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote, unquote_to_bytes

import anyio
import anyio.to_thread
from starlette.datastructures import Headers, QueryParams
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from gsynopsis.serve.answer import Replaced, file_answer
from gsynopsis.serve.assets import ASK, INDEX, Asset, Site, read_site
from gsynopsis.serve.files import ENDING, Root, address_of, shown_name
from gsynopsis.serve.gallery import Card, Catalogue, gallery, listing
from gsynopsis.serve.page import carrier
from gsynopsis.serve.refusal import has_body, not_allowed, refusal, sealed
from gsynopsis.serve.shaper import Shaper
from gsynopsis.stream.virtual import Link

EXPOSED = ["Accept-Ranges", "Content-Length", "Content-Range", "ETag", "Last-Modified"]
ASKED = ["Range", "If-Range", "If-None-Match", "If-Match", "Authorization"]
Report = Callable[[], object]
"""Makes something that can be said in JSON."""


class Server:
    """Answers GET and HEAD; everything else is refused before its body is read."""

    def __init__(self, root: Root, site: Site, reports: Mapping[str, Report]) -> None:
        """Scenes of a root, shown by a viewer if the site has one; reports by name."""
        self._root, self._site, self._reports = root, site, reports
        self._catalogue = Catalogue(root)
        # A thread of its own: a large folder must not hold up those that read files.
        self._looker = anyio.CapacityLimiter(1)
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
        headers = Headers(scope=scope)
        if has_body(headers):
            await refusal(scope["method"])(scope, receive, send)
        elif name_of(scope).endswith(ENDING):
            await self._scenes(scope, receive, send)
        elif scope["method"] not in {"GET", "HEAD"}:
            await _sent(not_allowed(), scope, receive, send)
        else:
            await _sent(await self._page(scope, headers), scope, receive, send)

    async def _scene(self, scope: Scope, receive: Receive, send: Send) -> None:
        await _sent(await self._scene_answer(scope), scope, receive, send)

    async def _scene_answer(self, scope: Scope) -> Response:
        if scope["method"] not in {"GET", "HEAD"}:
            return not_allowed()
        try:
            file = self._root.open(name_of(scope))
            if file is None:
                return PlainTextResponse("not found", 404)
            return await file_answer(file, scope["method"], Headers(scope=scope))
        except (OSError, Replaced):
            # No descriptor is left, the disk fails, or somebody writes into the file.
            return PlainTextResponse("not now", 503, {"retry-after": "1"})

    async def _page(self, scope: Scope, asked: Headers) -> Response:
        name = name_of(scope)
        if name == "listing.json":
            cards, _ = await self._look()
            return JSONResponse(listing(cards), headers={"cache-control": ASK})
        if name in self._reports:
            return JSONResponse(self._reports[name](), headers={"cache-control": "no-store"})
        if not name or name == INDEX:
            content = bool(name) or "content" in QueryParams(scope["query_string"])
            return (await self._index(content)).answer(asked)
        found = self._site.find(name)
        if found is None:
            return PlainTextResponse("not found", 404)
        asset, cache = found
        return asset.answer(asked, cache)

    async def _index(self, content: bool) -> Asset:
        """The viewer with the scene that the address names, or the only one; else the gallery."""
        page = self._site.page() if content else None
        if page is not None:
            return page
        cards, count = await self._look()
        if len(cards) == 1 or self._root.only:
            page = self._site.page("".join(map(carrier_of, cards)))
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
) -> ASGIApp:
    """The server's application.

    Args:
        root: What may be served.
        viewer: Folder of the built viewer, read now; without one `/` is a plain page.
        link: Shape all answers like this, None for as fast as it goes.
        embed: Origins whose pages may show ours in a frame.
        reports: Made anew for each request, by the name under which they are found.

    Raises:
        InputError: the viewer's folder holds none.
        SettingError: an origin is none.
    """
    server = Server(root, read_site(viewer, embed) if viewer else Site(), reports or {})
    return server if link is None else Shaper(server, link)


def carrier_of(card: Card) -> str:
    """The element in which a page finds a scene; it asks for the base first, exactly."""
    base = card.levels[0][0] if card.levels else 0
    return carrier(shown_name(card.name), address_of(card.name), first=base)


def name_of(scope: Scope) -> str:
    """The name that a request asks for, byte for byte as the file system has it."""
    raw = scope.get("raw_path") or quote(scope["path"]).encode()
    return os.fsdecode(unquote_to_bytes(raw)).removeprefix("/")


async def _sent(answer: Response, scope: Scope, receive: Receive, send: Send) -> None:
    await sealed(answer)(scope, receive, send)
