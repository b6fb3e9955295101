"""The application: files with ranges, a listing, a page."""

import html
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from gsynopsis.serve.files import SHORT, Root, file_answer, listing
from gsynopsis.serve.shaper import Shaper
from gsynopsis.stream.virtual import Link

EXPOSED = ["Accept-Ranges", "Content-Length", "Content-Range", "ETag", "Last-Modified"]
PAGE = """<!doctype html>
<meta charset="utf-8">
<title>gsynopsis</title>
<h1>Scenes</h1>
<ul>
{rows}
</ul>
<p>The same as JSON: <a href="listing.json">listing.json</a></p>
"""


def make_app(
    root: Root,
    *,
    viewer: Path | None = None,
    link: Link | None = None,
) -> Starlette:
    """The server's application.

    Args:
        root: What may be served.
        viewer: Folder of the built viewer, served at `/`; without one `/` is a plain page.
        link: Shape all answers like this, None for as fast as it goes.
    """
    pages = Root(viewer.resolve()) if viewer else None

    async def show_listing(request: Request) -> Response:
        return JSONResponse(listing(root, request), headers={"cache-control": SHORT})

    async def show_page(request: Request) -> Response:
        if pages is not None:
            return file_answer(pages, "index.html")
        names = "\n".join(f"<li>{html.escape(name)}</li>" for name in root.names())
        return HTMLResponse(PAGE.format(rows=names), headers={"cache-control": SHORT})

    async def show_file(request: Request) -> Response:
        name = request.path_params["name"]
        answer = file_answer(root, name)
        if answer.status_code == 404 and pages is not None:
            return file_answer(pages, name)
        return answer

    cors = Middleware(
        CORSMiddleware,
        allow_origins=["*"],
        allow_methods=["GET", "HEAD"],
        allow_headers=["Range", "If-Range", "If-None-Match", "Authorization"],
        expose_headers=EXPOSED,
        max_age=86400,
    )
    middleware = [cors]
    if link is not None:
        middleware.insert(0, Middleware(Shaper, link=link))
    routes = [
        Route("/", show_page, methods=["GET"]),
        Route("/listing.json", show_listing, methods=["GET"]),
        Route("/{name:path}", show_file, methods=["GET"], name="file"),
    ]
    return Starlette(routes=routes, middleware=middleware)
