"""A tiny image of the first view, as a note of the manifest: a page shows it while it loads.

It stands before all else and delays the first image by its own bytes, so it is kept far below
what the format allows.
"""

import base64
import binascii
import struct

from gsynopsis.container.layout import POSTER_BYTES_MAX, POSTER_PIXELS_MAX

HEAD = struct.Struct("<4sI8sI3s3sHH")
"""RIFF, its size, WEBPVP8, the frame's size, its tag, the start code, width and height."""
SIDE = 0x3FFF
"""Bits of width and height; two more are a hint on scaling."""


def poster_text(webp: bytes) -> str:
    """An image as the text of the note; empty if it is none that readers show.

    Args:
        webp: A WebP file.
    """
    text = base64.b64encode(webp).decode("ascii")
    return text if parse_poster(text) is not None else ""


def parse_poster(text: str) -> bytes | None:
    """The WebP file in a note; None if readers do not show it.

    Only the one simple form is shown, and of few pixels: 4 KiB of an image can claim gigabytes.
    """
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return None
    if not HEAD.size <= len(data) <= POSTER_BYTES_MAX:
        return None
    riff, size, kind, frame, tag, start, *sides = HEAD.unpack_from(data)
    if (riff, kind, start) != (b"RIFF", b"WEBPVP8 ", b"\x9d\x01*") or tag[0] & 1:
        return None
    fits = all(1 <= side & SIDE <= POSTER_PIXELS_MAX for side in sides)
    whole = size == len(data) - 8 and frame + frame % 2 == len(data) - 20
    return data if fits and whole else None
