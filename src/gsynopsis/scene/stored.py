"""Photos as stored on disk: opened by their contents, not by their name.

Only formats that are pixels are opened; Pillow's others start programs or ask for plug-ins. Pixels
are decoded under `DECODING`, so that several large photos are not in memory at once.
"""

import io
import struct
import threading
import zlib
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from PIL import Image, ImageCms, UnidentifiedImageError, features
from PIL.PngImagePlugin import PngImageFile

from gsynopsis.errors import SceneError
from gsynopsis.files import open_regular

AVIF = ("AVIF",) if features.check("avif") else ()
"""The format if Pillow was built with it."""
FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP", "GIF", "PPM", *AVIF)
"""Pillow's names of the formats that are read."""
MOST_PIXELS = 2**28
"""Most pixels of a photo: a decoded one takes four bytes for each, and some steps hold a copy."""
AT_ONCE = 2**26
"""Pixels that are decoded at a time, in all threads; a larger photo is decoded alone."""
DEEP_MODES = ("I", "F")
"""Pillow's modes of 32 bits, whose range nobody knows."""
SIXTEEN = "I;16"
"""Beginning of the modes of 16 bits, which `convert` would clip instead of scale."""
DECODE_ERRORS = (
    *(OSError, SyntaxError, ValueError, EOFError, MemoryError, Image.DecompressionBombError),
)
"""Errors that Pillow raises on bytes that are not a whole image, or too large a one."""
ORIENTATION = 0x0112
"""The EXIF tag."""
QUARTER_TURNS = {5, 6, 7, 8}
"""Its values that swap width and height."""
PNG_PIXELS = {b"IDAT", b"fdAT"}
"""Chunks of a PNG that hold pixels."""
PNG_END = struct.pack(">I4sI", 0, b"IEND", zlib.crc32(b"IEND"))
LONGEST_TAG = 2**24
"""Bytes of a PNG's other chunks, at most; longer ones are passed over."""
SAME = 2
"""Most levels of 255 by which a profile that is sRGB in all but name differs from it."""


AGAIN = "copy or export the photo again"


class Decoding:
    """Permission to decode: many small photos at a time, large ones one after the other."""

    def __init__(self, most: int) -> None:
        """Allow at most `most` pixels at a time."""
        self._most, self._held = most, 0
        self._changed = threading.Condition()

    def allow(self, most: int) -> None:
        """Allow at most `most` pixels at a time from now on."""
        with self._changed:
            self._most = most
            self._changed.notify_all()

    def fits(self, image: Image.Image) -> bool:
        """True if there is room for an image's pixels, or nothing else is decoded."""
        pixels = image.width * image.height
        return not self._held or self._held + pixels <= self._most

    @contextmanager
    def of(self, image: Image.Image) -> Generator[None]:
        """Waits until an image fits, and holds the room for its pixels."""
        pixels = image.width * image.height
        with self._changed:
            self._changed.wait_for(lambda: self.fits(image))
            self._held += pixels
        try:
            yield
        finally:
            with self._changed:
                self._held -= pixels
                self._changed.notify_all()


DECODING = Decoding(AT_ONCE)
# Pillow refuses photos of more than twice this; we refuse them by `MOST_PIXELS` before it decodes.
Image.MAX_IMAGE_PIXELS = MOST_PIXELS


@contextmanager
def opened_photo(path: Path) -> Generator[Image.Image]:
    """A photo whose header was read; pixels are decoded on access, see `DECODING`.

    Raises:
        SceneError: It is not a regular file, not an image of a known format, has more than 8 bits
            or too many pixels; or the body of the `with` raises one of `DECODE_ERRORS`.
    """
    try:
        with (
            open_regular(path, SceneError, "a photo") as file,
            Image.open(file, formats=FORMATS) as image,
        ):
            if image.mode in DEEP_MODES:
                found = f"mode {image.mode}"
                raise SceneError(path, "pixels", found=found, expected="8 or 16 bits a channel")
            if image.width * image.height > MOST_PIXELS:
                raise _too_large(path, f"{image.width}x{image.height} pixels")
            yield image
    except Image.DecompressionBombError as error:
        raise _too_large(path, str(error).split(" exceeds")[0]) from error
    except DECODE_ERRORS as error:
        raise _unreadable(path, error) from error


@dataclass(frozen=True)
class PhotoHeader:
    """Facts about a photo that precede its pixels.

    Attributes:
        size: Width and height as stored, pixels.
        orientation: EXIF's value; 1 is upright.
        colors: Name of its colour profile if it is converted to sRGB, else empty.
        alpha: It may have transparent pixels.
    """

    size: tuple[int, int]
    orientation: int
    colors: str = ""
    alpha: bool = False


def read_header(path: Path) -> PhotoHeader:
    """The header of a photo that something names.

    Raises:
        SceneError: The file is missing, or see `opened_photo`.
    """
    if not path.exists():
        found, wanted = "no such file", "the photo that the scene lists"
        raise SceneError(path, "image", found=found, expected=wanted)
    with opened_photo(path) as image:
        return PhotoHeader(image.size, orientation_of(image), colors_of(image), has_alpha(image))


def orientation_of(image: Image.Image) -> int:
    """The EXIF orientation of an opened photo; 1 where it has none, or a damaged one."""
    try:
        tag = exif_of(image).get(ORIENTATION)
    except DECODE_ERRORS:
        return 1
    return tag if isinstance(tag, int) and 1 <= tag <= 8 else 1


def exif_of(image: Image.Image) -> Image.Exif:
    """EXIF of an opened photo; no pixel is decoded.

    A PNG may have it behind its pixels, and Pillow would decode all of them to get there.

    Raises:
        OSError, SyntaxError, ValueError: What is there is damaged, see `DECODE_ERRORS`.
    """
    if not isinstance(image, PngImageFile) or "exif" in image.info or image.fp is None:
        return image.getexif()
    bare = io.BytesIO(_without_pixels(image.fp))
    with Image.open(bare, formats=("PNG",)) as header:
        return Image.Image.getexif(header)


def _without_pixels(png: IO[bytes]) -> bytes:
    """An open PNG's bytes but for its pixels; where it is read next stays the same."""
    place = png.tell()
    try:
        png.seek(0)
        kept = [png.read(8)]
        while len(head := png.read(8)) == 8:
            length, name = struct.unpack(">I4s", head)
            if name in PNG_PIXELS or length > LONGEST_TAG:
                png.seek(length + 4, io.SEEK_CUR)
            elif len(body := png.read(length + 4)) == length + 4:
                kept.append(head + body)
        return b"".join((*kept, PNG_END))
    finally:
        png.seek(place)


def in_8_bits(image: Image.Image) -> Image.Image:
    """A grey image of 16 bits in 8; others, whose channels Pillow reads in 8, as they are."""
    if not image.mode.startswith(SIXTEEN):
        return image
    values = np.asarray(image).astype(np.uint32)
    return Image.fromarray(((values + 128) // 257).astype(np.uint8))


def has_alpha(image: Image.Image) -> bool:
    """True if an opened photo has an alpha channel, or a colour that stands for none."""
    return image.mode in {"RGBA", "LA", "PA", "RGBa", "La"} or "transparency" in image.info


def colors_of(image: Image.Image) -> str:
    """The name of a photo's colour profile if `in_srgb` converts it; empty for sRGB and others."""
    conversion = _conversion(image.info.get("icc_profile"))
    return "" if conversion is None else conversion.name


def in_srgb(image: Image.Image, profile: bytes | None) -> Image.Image:
    """An RGB image of a colour profile in sRGB; itself where the profile is sRGB, or no RGB.

    Args:
        image: Mode RGB or RGBA; others are returned as they are.
        profile: ICC profile of the photo.
    """
    conversion = _conversion(profile)
    if conversion is None or image.mode not in ("RGB", "RGBA"):
        return image
    found = ImageCms.applyTransform(image.convert("RGB"), conversion.transform)
    assert found is not None  # not in place
    if image.mode == "RGBA":
        found.putalpha(image.getchannel("A"))
    return found


@dataclass(frozen=True)
class _Conversion:
    name: str
    transform: ImageCms.ImageCmsTransform


@lru_cache(maxsize=16)
def _conversion(profile: bytes | None) -> _Conversion | None:
    """Transform of an RGB profile to sRGB; None where it changes nothing, or cannot be read."""
    if not profile or profile[16:20] != b"RGB ":
        return None
    try:
        own = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
        # Pillow does not say of what type this is.
        srgb = cast(Any, ImageCms.createProfile("sRGB"))  # pyright: ignore[reportUnknownMemberType]
        transform = ImageCms.buildTransform(own, srgb, "RGB", "RGB", intent)
        steps = np.linspace(0, 255, 9).round().astype(np.uint8)
        palette = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(27, 27, 3)
        found = ImageCms.applyTransform(Image.fromarray(palette), transform)
        off = np.abs(np.asarray(found).astype(int) - palette).max()
        name = ImageCms.getProfileDescription(own).strip()[:40] or "a profile without a name"
    except (ImageCms.PyCMSError, *DECODE_ERRORS):
        return None
    return _Conversion(name, transform) if off > SAME else None


def profile_notes(colors: Iterable[str]) -> list[str]:
    """A sentence on photos whose colours are converted, see `PhotoHeader.colors`."""
    wide = [name for name in colors if name]
    if not wide:
        return []
    named = ", ".join(sorted(set(wide)))
    return [f"{len(wide)} photos have colours of {named}: converted to sRGB"]


def _too_large(path: Path, found: str) -> SceneError:
    wanted = f"at most {MOST_PIXELS:,} pixels"
    return SceneError(path, found=found, expected=wanted, advice="make its sides half as long")


def _unreadable(path: Path, error: Exception) -> SceneError:
    if isinstance(error, UnidentifiedImageError):
        found, wanted = "none of these", f"a whole image: {', '.join(FORMATS)}"
        return SceneError(path, "pixels", found=found, expected=wanted, advice=AGAIN)
    if isinstance(error, MemoryError):
        return SceneError(path, "pixels", found="not enough memory", expected="a smaller photo")
    reason = str(error).split("\n")[0].replace(str(path), "the file")
    return SceneError(path, "pixels", found=reason, expected="a whole image", advice=AGAIN)
