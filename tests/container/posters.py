"""Notes that readers take for posters, and notes that they must not."""

import base64
import io
import struct

import numpy as np
from PIL import Image


def webp(width: int, height: int, colour: tuple[int, int, int] | None = None) -> bytes:
    """A picture as WebP of the simple lossy form: noise, or one colour."""
    pixels = np.random.default_rng(1).integers(0, 256, (height, width, 3), np.uint8)
    if colour is not None:
        pixels[:] = colour
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "WEBP", quality=40)
    return stream.getvalue()


def text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def changed(at: int, new: bytes) -> str:
    data = bytearray(webp(48, 32))
    data[at : at + len(new)] = new
    return text(bytes(data))


def other(kind: str, **options: object) -> str:
    stream = io.BytesIO()
    Image.new("RGB", (8, 8), "red").save(stream, kind, **options)
    return text(stream.getvalue())


GOOD = {
    "small": text(webp(48, 32)),
    "one pixel": text(webp(1, 1)),
    "largest": text(webp(64, 64, (9, 99, 199))),
}
REFUSED = {
    "empty": "",
    "no base64": "<img src=x onerror=alert(1)>",
    "spaces": f" {GOOD['small']}",
    "no padding": text(webp(48, 32) + b"\0").rstrip("="),
    "too wide": text(webp(65, 32)),
    "claims 16383 pixels": changed(26, struct.pack("<H", 16383)),
    "claims none": changed(28, struct.pack("<H", 0)),
    "a byte too many": text(webp(48, 32) + b"\0"),
    "a byte too few": text(webp(48, 32)[:-1]),
    "another size": changed(4, struct.pack("<I", 7)),
    "another frame's size": changed(16, struct.pack("<I", 7)),
    "no key frame": changed(20, bytes([webp(48, 32)[20] | 1])),
    "no start code": changed(23, b"\0"),
    "too long": text(webp(64, 64) + bytes(4096)),
    "head alone": text(webp(48, 32)[:29]),
    "PNG": other("PNG"),
    "JPEG": other("JPEG"),
    "lossless": other("WEBP", lossless=True),
    "not of ASCII": "ä" * 40,
}
