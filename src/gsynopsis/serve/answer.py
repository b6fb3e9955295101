"""Answers about one version of something: conditions, ranges, bodies (RFC 9110 §13 and §14)."""

import time
from collections.abc import AsyncGenerator, Mapping
from email.utils import formatdate, parsedate_to_datetime
from secrets import token_hex

import anyio.to_thread
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from gsynopsis.serve.files import OpenFile
from gsynopsis.serve.ranges import plain_range

LONG = "public, max-age=31536000"
"""Scenes: a year. A client that goes on after a change notices it by the ETag."""
PIECE = 1 << 16
"""Bytes read at once; a shorter answer needs no file while it is sent."""
MEDIA = "application/octet-stream"
SURE_SECONDS = 2.0
"""A date tells versions apart if the file was left alone for so long (§8.8.2.2)."""

Segment = bytes | tuple[int, int]
"""Part of a body: these bytes, or those of the file from start to stop."""


class Replaced(Exception):
    """Somebody writes into the file that is being sent; the connection ends."""


def precondition(headers: Headers, tag: str, modified: float | None = None) -> int:
    """What the conditions of a request lead to (§13.2.2).

    Args:
        headers: Of the request.
        tag: ETag of what would be sent.
        modified: Its time of change, seconds since the epoch, None if there is none.

    Returns:
        412 (something else was expected), 304 (the client has this version), or 0 to go on.
    """
    match = headers.get("if-match")
    older = _not_after(modified, headers.get("if-unmodified-since"))
    if older is False if match is None else not _named(match, tag, weak=False):
        return 412
    match = headers.get("if-none-match")
    older = _not_after(modified, headers.get("if-modified-since"))
    return 304 if (older if match is None else _named(match, tag, weak=True)) else 0


def _named(header: str, tag: str, *, weak: bool) -> bool:
    words = [word.strip() for word in header.split(",")]
    return "*" in words or tag in ([w.removeprefix("W/") for w in words] if weak else words)


def _not_after(modified: float | None, date: str | None) -> bool | None:
    """It was changed in that second or before; None where there is no time or no such date."""
    if modified is None or not date:
        return None
    try:
        return int(modified) <= parsedate_to_datetime(date).timestamp()
    except (TypeError, ValueError, OverflowError):
        return None


async def file_answer(file: OpenFile, method: str, asked: Headers) -> Response:
    """200, 206, 304, 412 or 416; the answer closes the file, or has closed it."""
    try:
        answer = await _file_answer(file, method, asked)
    except BaseException:
        file.close()
        raise
    if not isinstance(answer, FileBody):
        file.close()
    return answer


async def _file_answer(file: OpenFile, method: str, asked: Headers) -> Response:
    seconds = file.modified / 1e9
    modified = formatdate(seconds, usegmt=True)
    headers = {"etag": file.tag, "cache-control": LONG, "last-modified": modified}
    status = precondition(asked, file.tag, seconds)
    if status == 304:
        return Response(status_code=304, headers=headers)
    if status == 412:
        return PlainTextResponse("another version is here", 412, {"etag": file.tag})
    headers["accept-ranges"] = "bytes"
    # Only GET has ranges, and one for another version of the file is void (§14.2, §13.1.5).
    wanted = asked.get("range") if method == "GET" else None
    if wanted is not None and not _same_version(asked.get("if-range"), file, modified):
        wanted = None
    parts = "whole" if wanted is None else plain_range(wanted, file.size)
    if parts == "unsatisfiable":
        outside = {"content-range": f"bytes */{file.size}"}
        return PlainTextResponse("range not satisfiable", 416, outside)
    status, media, segments = _segments(parts, file, headers)
    length = sum(len(s) if isinstance(s, bytes) else s[1] - s[0] for s in segments)
    headers["content-length"] = str(length)
    if method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=media)
    content = pieces(file, segments)
    if length > PIECE:
        return FileBody(file, content, status, headers, media)
    return Response(b"".join([piece async for piece in content]), status, headers, media)


def _same_version(condition: str | None, file: OpenFile, modified: str) -> bool:
    """If-Range, where there is one, names this version."""
    if condition is None or condition == file.tag:
        return True
    return condition == modified and time.time() - file.modified / 1e9 > SURE_SECONDS


def _segments(
    parts: list[tuple[int, int]] | str, file: OpenFile, headers: dict[str, str]
) -> tuple[int, str, list[Segment]]:
    """Status, content type and body of an answer with these parts; adds to the headers."""
    if isinstance(parts, str):
        return 200, MEDIA, [(0, file.size)]
    spans = [f"bytes {start}-{stop - 1}/{file.size}" for start, stop in parts]
    if len(parts) == 1:
        headers["content-range"] = spans[0]
        return 206, MEDIA, list(parts)
    boundary = token_hex(13)
    segments: list[Segment] = []
    for part, span in zip(parts, spans, strict=True):
        head = f"--{boundary}\r\nContent-Type: {MEDIA}\r\nContent-Range: {span}\r\n\r\n"
        segments += [head.encode(), part, b"\r\n"]
    segments.append(f"--{boundary}--\r\n".encode())
    return 206, f"multipart/byteranges; boundary={boundary}", segments


async def pieces(file: OpenFile, segments: list[Segment]) -> AsyncGenerator[bytes]:
    """A body.

    Raises:
        Replaced: the file is not the one that was opened any more.
    """
    for segment in segments:
        if isinstance(segment, bytes):
            yield segment
            continue
        for start in range(*segment, PIECE):
            stop = min(start + PIECE, segment[1])
            piece = await anyio.to_thread.run_sync(file.read, start, stop)
            # Bytes of two versions, or a body that is padded, must not look like an answer.
            if len(piece) < stop - start or not file.unchanged():
                raise Replaced
            yield piece


class FileBody(StreamingResponse):
    """Pieces of an open file, which is closed in the end however it ends."""

    def __init__(
        self,
        file: OpenFile,
        content: AsyncGenerator[bytes],
        status: int,
        headers: Mapping[str, str],
        media: str,
    ) -> None:
        """Nothing is read yet."""
        super().__init__(content, status, headers, media)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._file.close()
