"""Files below one root, and nothing else: names to paths, headers, bodies."""

import hashlib
import os
import stat
from dataclasses import dataclass
from email.utils import formatdate, parsedate_to_datetime
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.types import Receive, Scope, Send

from gsynopsis.errors import InputError
from gsynopsis.serve.ranges import plain_range

TYPES = {
    ".gsyn": "application/octet-stream",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".map": "application/json",
    ".wasm": "application/wasm",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".webp": "image/webp",
    ".ico": "image/x-icon",
    ".txt": "text/plain; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
}
"""Content types by ending; everything else is `application/octet-stream`."""
LONG = "public, max-age=31536000"
"""Scenes: a year. A client that goes on after a change notices it by the ETag."""
SHORT = "no-cache"
"""Pages: ask every time whether they changed."""
PAGES = {".html", ".json"}


@dataclass(frozen=True)
class Root:
    """What may be served: a folder's files, or one file.

    Attributes:
        folder: Resolved folder.
        only: Name of the one file in it that is served, empty for all.
    """

    folder: Path
    only: str = ""

    def find(self, name: str) -> Path | None:
        """The regular file of that name, None if there is none that may be served.

        Hidden names, `..`, and links that lead out of the folder find nothing.
        """
        parts = name.split("/")
        if "\0" in name or any(not part or part.startswith(".") for part in parts):
            return None
        if self.only and name != self.only:
            return None
        try:
            path = (self.folder / name).resolve(strict=True)
            regular = stat.S_ISREG(path.stat().st_mode)
        except (OSError, RuntimeError, ValueError):
            return None
        return path if regular and path.is_relative_to(self.folder) else None

    def names(self) -> list[str]:
        """All `.gsyn` files that may be served, sorted."""
        found = [self.folder / self.only] if self.only else self.folder.rglob("*.gsyn")
        names = (path.relative_to(self.folder).as_posix() for path in found)
        return sorted(name for name in names if self.find(name) is not None)


def root_of(path: Path) -> Root:
    """The root for a folder or a single file.

    Raises:
        InputError: there is neither.
    """
    try:
        real = path.resolve(strict=True)
    except OSError as error:
        expected = "a folder or a .gsyn file"
        raise InputError(path, found=error.strerror or error, expected=expected) from error
    if real.is_dir():
        return Root(real)
    return Root(real.parent, real.name)


def tag_of(state: os.stat_result) -> str:
    """A strong ETag: another one whenever the file was replaced or written."""
    text = f"{state.st_ino}-{state.st_mtime_ns}-{state.st_size}"
    return f'"{hashlib.sha256(text.encode()).hexdigest()[:24]}"'


class Served(FileResponse):
    """One file with its headers; the range of the request is made plain first."""

    def __init__(self, path: Path, state: os.stat_result) -> None:
        """Takes the state of the file that `tag_of` describes."""
        ending = path.suffix.lower()
        headers = {
            "etag": tag_of(state),
            "cache-control": SHORT if ending in PAGES else LONG,
            "x-content-type-options": "nosniff",
        }
        media_type = TYPES.get(ending, "application/octet-stream")
        super().__init__(path, headers=headers, media_type=media_type, stat_result=state)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with 200, 206, 304 or 416."""
        headers = Headers(scope=scope)
        if unchanged(headers, self.headers["etag"], self.headers["last-modified"]):
            kept = {k: self.headers[k] for k in ("etag", "cache-control", "last-modified")}
            await Response(status_code=304, headers=kept)(scope, receive, send)
            return
        wanted = headers.get("range")
        condition = headers.get("if-range")
        size = self.stat_result.st_size if self.stat_result else 0
        if wanted is not None:
            meaning = plain_range(wanted, size)
            # Only GET has ranges, and one for another version of the file is void (§14.2, §13.1.5).
            other = condition is not None and not self._should_use_range(condition)
            if scope["method"] != "GET" or other:
                meaning = "whole"
            if meaning == "unsatisfiable":
                answer = PlainTextResponse(
                    "range not satisfiable", 416, {"content-range": f"bytes */{size}"}
                )
                await answer(scope, receive, send)
                return
            scope = _with_range(scope, None if meaning == "whole" else meaning)
        await super().__call__(scope, receive, send)


def unchanged(headers: Headers, tag: str, modified: str) -> bool:
    """If-None-Match, else If-Modified-Since, says that the client has this version (§13.2.2)."""
    match = headers.get("if-none-match")
    if match is not None:
        known = {word.strip().removeprefix("W/") for word in match.split(",")}
        return "*" in known or tag in known
    since = headers.get("if-modified-since")
    if since is None:
        return False
    try:
        return parsedate_to_datetime(since) >= parsedate_to_datetime(modified)
    except (TypeError, ValueError):
        return False


def _with_range(scope: Scope, wanted: str | None) -> Scope:
    """The same request with another Range header, or none."""
    copied = dict(scope)
    copied["headers"] = [(k, v) for k, v in scope["headers"] if k != b"if-range"]
    headers = MutableHeaders(scope=copied)
    del headers["range"]
    if wanted is not None:
        headers["range"] = wanted
    return copied


def file_answer(root: Root, name: str) -> Response:
    """A file of the root, or 404."""
    path = root.find(name)
    if path is None:
        return PlainTextResponse("not found", 404)
    try:
        return Served(path, path.stat())
    except OSError:
        return PlainTextResponse("not found", 404)


def listing(root: Root, request: Request) -> dict[str, object]:
    """What is there to be streamed, as a page can use it."""
    files: list[dict[str, object]] = []
    for name in root.names():
        state = (root.folder / name).stat()
        files.append(
            {
                "name": name,
                "bytes": state.st_size,
                "modified": formatdate(state.st_mtime, usegmt=True),
                "etag": tag_of(state),
                "url": str(request.url_for("file", name=name)),
            }
        )
    return {"files": files}
