"""A whole file of a web server into a folder."""

import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import TypeGuard
from urllib.parse import unquote, urlsplit

from gsynopsis.errors import InputError, MissingExtraError, SourceError
from gsynopsis.files import published

DOWNLOAD_MAX = 8 << 30
"""Bytes of a file: 20 million splats as 3DGS writes them have 5 GiB."""
SECONDS = 30.0
"""Without a byte after which a download ends."""
NAME_MAX = 100
WEB = ("http://", "https://")


def is_address(source: object) -> TypeGuard[str]:
    """True for the address of a file on a web server."""
    return isinstance(source, str) and source.startswith(WEB)


def name_of(address: str) -> str:
    """The file's name in an address, as a name on the disk: letters, digits and a few signs.

    Raises:
        InputError: the address has no name, or that of a file that names others beside it.
    """
    try:
        name = PurePosixPath(unquote(urlsplit(address).path)).name
    except ValueError:
        name = ""
    name = re.sub(r"[^\w. +-]", "_", name)[-NAME_MAX:].lstrip(".")
    if not name:
        raise InputError(address, found="no name of a file", expected="the address of a file")
    if name.lower().endswith(".json"):
        advice = "download its folder and give that, or give the .sog or .ssog that has all"
        expected = "a file that holds the splats"
        raise InputError(address, found="a list of other files", expected=expected, advice=advice)
    return name


def downloaded(
    address: str, folder: Path, tick: Callable[[int, int], None], most: int = DOWNLOAD_MAX
) -> Path:
    """The file at an address, in a folder under its own name.

    Args:
        address: An http or https address; redirections are followed.
        folder: It is written to, whole or not at all.
        tick: Told of bytes that have come, and of how many there are; 0 if the server keeps that.
        most: Bytes.

    Raises:
        InputError: the address names no file of splats.
        SourceError: the server does not give it whole, or it is larger than `most`.
        SpaceError: the disk is full.
        MissingExtraError: httpx is not installed.
    """
    path = folder / name_of(address)
    try:
        import httpx

        from gsynopsis.stream.http import body_of, translated
    except ModuleNotFoundError as error:
        raise MissingExtraError("httpx", "stream") from error
    shown = address.partition("?")[0]  # the rest may be a signature
    try:
        client = httpx.Client(timeout=SECONDS, follow_redirects=True)
        plain = {"Accept-Encoding": "identity"}
        with client, client.stream("GET", address, headers=plain) as response:
            if response.status_code != 200:
                found = f"{response.status_code} {response.reason_phrase}".strip()
                raise SourceError(shown, found=found, expected="200")
            length = response.headers.get("content-length", "")
            total = int(length) if length.isascii() and length.isdecimal() else 0
            got = 0
            with published(path) as draft, draft.open("wb") as file:
                for piece in body_of(response, shown):
                    got += len(piece)
                    if max(got, total) > most:
                        found = f"{max(got, total):,} bytes or more"
                        raise SourceError(shown, found=found, expected=f"at most {most:,}")
                    file.write(piece)
                    tick(got, total)
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        raise translated(shown, error) from error
    return path
