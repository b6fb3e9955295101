"""A file on a web server, read in ranges; falls back to the whole file where ranges do not work.

A range is believed only if the answer is 206 with the very Content-Range that was asked for and
without a Content-Encoding: servers that compress ranges, or answer with another one, exist. Then,
and where a server answers 200, the whole file is read once, up to a cap, and ranges are cut here.

Nothing is asked for compressed. Of codings that come all the same one alone, gzip, is undone, a
piece at a time: libraries inflate whatever came at once, and a few kilobytes may be gigabytes.
"""

import re
import ssl
import threading
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import httpx

from gsynopsis.errors import ChangedError, SourceError, TransientError
from gsynopsis.stream.local import clipped
from gsynopsis.stream.source import PIECE, broken_off

WHOLE_MAX = 256 << 20
"""Bytes of a whole file that are kept in memory where a server has no ranges."""
TIMEOUT = 10.0
"""Seconds without a byte after which a read breaks off (dash.js abandons after 10)."""
BUSY = (408, 425, 429, 500, 502, 503, 504)
"""Answers worth another try."""
CONTENT_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+|\*)")
TEXT_MAX = 80


@dataclass(frozen=True)
class FileVersion:
    """Identity of a version of a file; empty parts are not known."""

    tag: str = ""
    modified: str = ""
    size: int = 0

    def differs(self, other: "FileVersion") -> bool:
        """A part that both know is not the same."""
        pairs = ((self.tag, other.tag), (self.size, other.size), (self.modified, other.modified))
        return any(a != b for a, b in pairs if a and b)

    @property
    def condition(self) -> str:
        """For If-Range: a strong tag, else nothing (a date has seconds only: not safe)."""
        return self.tag if self.tag.startswith('"') else ""


class HttpSource:
    """One address. Reads may run in several threads; the first answer fixes the version."""

    def __init__(
        self,
        address: str,
        *,
        whole_max: int = WHOLE_MAX,
        client: httpx.Client | None = None,
    ) -> None:
        """Prepare a source; nothing is fetched yet.

        Args:
            address: An http or https URL.
            whole_max: Most bytes kept if the server has no ranges.
            client: Another client, for tests; closed with the source.

        Raises:
            SourceError: it is not such a URL.
        """
        try:
            url = httpx.URL(address)
        except httpx.InvalidURL as error:
            raise SourceError(address, found=error, expected="an http address") from error
        if url.scheme not in {"http", "https"} or not url.host:
            raise SourceError(address, found="no http address", expected="http://… or https://…")
        self._address, self._whole_max = address, whole_max
        self._client = client or httpx.Client(timeout=TIMEOUT, follow_redirects=True)
        self._lock = threading.Lock()
        self._stamp = FileVersion()
        self._whole: _Whole | None = None

    @property
    def size(self) -> int | None:
        """See `ByteSource.size`."""
        return self._stamp.size or None

    @property
    def name(self) -> str:
        """The address without its query, which may hold a signature."""
        return self._address.partition("?")[0]

    def read(self, start: int, stop: int) -> Iterator[bytes]:
        """See `ByteSource.read`; bytes beyond `stop` from a server without ranges are kept."""
        if not 0 <= start < stop:
            raise SourceError(self.name, "range", found=f"{start} to {stop}")
        if self._whole is None:
            response = self._ask({"Range": f"bytes={start}-{stop - 1}"})
            with ExitStack() as answer:
                answer.callback(response.close)
                length = self._length(response, start, stop)
                if length:
                    yield from _pieces(response, length, self.name)
                    return
                if response.status_code == 200:
                    answer.pop_all()
                    self._keep(response)
        if self._whole is None:
            self._keep(self._ask({}))
        whole = self._whole
        assert whole is not None
        try:
            yield from whole.read(start, stop)
        except TransientError:
            with self._lock:
                self._whole = None
            raise

    def close(self) -> None:
        """Give connections back."""
        self._client.close()

    def _ask(self, headers: dict[str, str]) -> httpx.Response:
        """Send a request; the answer's head is checked, its body is still to be read."""
        headers = {"Accept-Encoding": "identity", **headers}
        if "Range" in headers and self._stamp.condition:
            headers["If-Range"] = self._stamp.condition
        try:
            request = self._client.build_request("GET", self._address, headers=headers)
            response = self._client.send(request, stream=True)
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise translated(self.name, error) from error
        try:
            self._check(response)
        except SourceError:
            response.close()
            raise
        return response

    def _check(self, response: httpx.Response) -> None:
        """Refuse a status other than 200 and 206, and a version that is not the first one."""
        status = response.status_code
        found = f"{status} {response.reason_phrase}".strip()
        if status in BUSY:
            error = TransientError(self.name, found=found)
            error.after = _seconds(response.headers.get("retry-after", ""))
            raise error
        stamp = _stamp_of(response)
        with self._lock:
            known = self._stamp.size
            # Nothing is asked for behind the end of a known file, unless it has become shorter; a
            # refusal's Content-Range names the length.
            end = response.headers.get("content-range", "")
            shrunk = status == 416 and known and end != f"bytes */{known}"
            if self._stamp.differs(stamp) or shrunk:
                raise ChangedError(
                    self.name,
                    found="another version than at first",
                    advice="the file was replaced while it was read; start again",
                )
            if status not in {200, 206}:
                raise SourceError(self.name, found=found, expected="200 or 206")
            if self._stamp == FileVersion():
                self._stamp = stamp

    def _length(self, response: httpx.Response, start: int, stop: int) -> int:
        """Bytes of an answer that is the very range, or its part within the file; 0 if not."""
        encoded = _coding_of(response) != ""
        match = CONTENT_RANGE.fullmatch(response.headers.get("content-range", ""))
        if response.status_code != 206 or encoded or match is None or int(match[1]) != start:
            return 0
        end = int(match[2]) + 1
        clipped_here = match[3] != "*" and end == int(match[3]) < stop
        return end - start if end == stop or clipped_here else 0

    def _keep(self, response: httpx.Response) -> None:
        """Read the whole file from this answer; of two threads the first one wins."""
        size = 0 if _coding_of(response) else _stamp_of(response).size
        whole = None
        if response.status_code == 200:
            whole = _Whole(response, self.name, self._whole_max, size)
        with self._lock:
            if self._whole is None and whole is not None:
                self._whole = whole
                return
        response.close()
        if self._whole is None:
            found = f"{response.status_code} to a plain request"
            raise SourceError(self.name, found=found, expected="200")


class _Whole:
    """The body of an answer without ranges, read as far as needed and kept."""

    def __init__(self, response: httpx.Response, name: str, most: int, size: int) -> None:
        self._name, self._most, self._size = name, most, size
        if size > most:
            response.close()
            raise self._too_large(size)
        self._body, self._response = body_of(response, name), response
        self._kept = bytearray()
        self._ended = False
        self._lock = threading.Lock()

    def read(self, start: int, stop: int) -> Iterator[bytes]:
        at = start
        while at < stop:
            with self._lock:
                while len(self._kept) <= at and not self._ended:
                    self._more()
                if self._ended:
                    stop = clipped(self._name, start, stop, len(self._kept))
                piece = bytes(self._kept[at : min(stop, at + PIECE)])
            at += len(piece)
            yield piece

    def _more(self) -> None:
        try:
            self._kept += next(self._body)
        except StopIteration:
            if self._size and len(self._kept) < self._size:
                raise broken_off(self._name, len(self._kept), self._size) from None
            self._ended = True
            self._response.close()
        except httpx.HTTPError as error:
            raise translated(self._name, error) from error
        if len(self._kept) > self._most:
            self._response.close()
            raise self._too_large(len(self._kept))

    def _too_large(self, size: int) -> SourceError:
        found = f"a server without ranges and {size} bytes or more"
        advice = "use a host with Range requests"
        return SourceError(self._name, found=found, expected=f"at most {self._most}", advice=advice)


def _pieces(response: httpx.Response, wanted: int, name: str) -> Iterator[bytes]:
    """The body, exactly as long as wanted."""
    got = 0
    try:
        for piece in response.iter_raw():
            got += len(piece)
            if got > wanted:
                raise SourceError(name, found=f"{got} bytes or more", expected=f"{wanted}")
            yield piece
    except httpx.HTTPError as error:
        raise translated(name, error) from error
    if got < wanted:
        raise broken_off(name, got, wanted)


def _coding_of(response: httpx.Response) -> str:
    """The content coding of a body; empty without one."""
    coding = response.headers.get("content-encoding", "").strip().lower()
    return "" if coding == "identity" else coding


def body_of(response: httpx.Response, name: str) -> Iterator[bytes]:
    """The plain body in pieces of at most `PIECE` bytes, however much a few bytes inflate to.

    Raises:
        SourceError: it is wrapped in anything but one gzip, or in a damaged one.
    """
    coding = _coding_of(response)
    if coding not in {"", "gzip", "x-gzip"}:
        response.close()
        found, advice = f"Content-Encoding {coding[:TEXT_MAX]}", "have the host send it as it is"
        raise SourceError(name, found=found, expected="none", advice=advice)
    return _inflated(response.iter_raw(), name) if coding else response.iter_raw()


def _inflated(pieces: Iterator[bytes], name: str) -> Iterator[bytes]:
    """The inflated bytes of one gzip stream."""
    gzip = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        for piece in pieces:
            rest = piece
            while rest and not gzip.eof:
                yield gzip.decompress(rest, PIECE)
                rest = gzip.unconsumed_tail
    except zlib.error as error:
        found = f"a damaged gzip ({error})"
        raise SourceError(name, found=found[:TEXT_MAX], expected="no coding") from error
    if not gzip.eof:
        raise TransientError(name, found="a gzip that ends early")


def _stamp_of(response: httpx.Response) -> FileVersion:
    """The version that a 200 or 206 speaks of."""
    if response.status_code not in {200, 206}:
        return FileVersion()
    headers = response.headers
    match = CONTENT_RANGE.fullmatch(headers.get("content-range", ""))
    size = int(match[3]) if match and match[3] != "*" else 0
    if response.status_code == 200 and "content-encoding" not in headers:
        length = headers.get("content-length", "")
        size = int(length) if length.isdecimal() else 0
    # A compressed form has a tag of its own, which says nothing about the plain one.
    tag = "" if "content-encoding" in headers else headers.get("etag", "")
    return FileVersion(tag, headers.get("last-modified", ""), size)


def _seconds(text: str) -> float:
    """Retry-After in seconds; dates are taken as unknown."""
    return min(60.0, float(text)) if text.isdecimal() else 0.0


def translated(name: str, error: Exception) -> SourceError:
    """A library's error as ours; transient only if asking again may help."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, ssl.SSLError):
            advice = "the host's certificate or TLS cannot be trusted"
            return SourceError(name, found=_words(error), advice=advice)
        cause = cause.__cause__ or cause.__context__
    final = (httpx.UnsupportedProtocol, httpx.LocalProtocolError)
    if isinstance(error, httpx.TransportError) and not isinstance(error, final):
        return TransientError(name, found=_words(error))
    return SourceError(name, found=_words(error))


def _words(error: Exception) -> str:
    """A library's error in a few words."""
    return (str(error) or type(error).__name__)[:TEXT_MAX]
