"""Photos on disk: checked by their header, decoded when first asked for, kept in a budget.

Poses are those of the stored pixels, as COLMAP has them; the orientation tag of EXIF counts only
where it alone makes a photo the size of its camera. Photos of lenses with distortion are resampled
as pinhole images. Transparent images are composited onto black. Greyscale becomes RGB.
"""

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import STILL, Shift, scaled_size
from gsynopsis.scene.colmap.distortion import Warp
from gsynopsis.scene.resample import resample
from gsynopsis.scene.spheres import Cut, cut_view
from gsynopsis.scene.stored import (
    AVIF,
    DECODING,
    PhotoHeader,
    has_alpha,
    in_8_bits,
    in_srgb,
    opened_photo,
    read_header,
)

MASK_SUFFIXES = frozenset([".png", ".jpg", ".jpeg"])
"""Endings of masks."""
PHOTO_SUFFIXES = MASK_SUFFIXES | {".webp", ".tif", ".tiff"} | ({".avif"} if AVIF else set[str]())
"""Endings of photos where nothing else says which files are, in any case of letters."""
STRIP = 256
"""Rows of a photo that are converted at a time."""


@dataclass(frozen=True)
class PhotoForm:
    """Conversion of stored pixels to those of a pinhole camera, in this order.

    Attributes:
        turned: By the orientation tag of EXIF.
        warp: Then resampled to remove distortion, or a view cut out of a panorama; None: neither.
        size: Then resized to this width and height; None: not at all.
        mask: The photo is a mask, shown as grey; or its alpha channel is.
    """

    turned: bool = False
    warp: Warp | Cut | None = None
    size: tuple[int, int] | None = None
    mask: Literal["", "grey", "alpha"] = ""


AS_STORED = PhotoForm()


def is_photo(path: Path) -> bool:
    """True if a file's name is that of a photo."""
    return path.suffix.lower() in PHOTO_SUFFIXES


def expect_size(path: Path, size: tuple[int, int]) -> PhotoHeader:
    """An image's header, checked against its camera's size (width, height), pixels.

    Raises:
        SceneError: As `read_header`, or the sizes differ.
    """
    header = read_header(path)
    found = header.size
    if found != size:
        raise SceneError(
            path,
            "image size",
            found=f"{found[0]}x{found[1]}",
            expected=f"{size[0]}x{size[1]} as its camera says",
            advice="use the photos that the poses were estimated with",
        )
    return header


def check_photos(paths: Sequence[Path]) -> Iterator[Path]:
    """Decode photos, several at a time, and forget them; gives each once it is known to be whole.

    JPEG is decoded at an eighth of its size, which reads every byte as well and is quicker.

    Raises:
        SceneError: The pixel data of one cannot be decoded.
    """
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        yield from pool.map(_decoded, paths)


def _decoded(path: Path) -> Path:
    with opened_photo(path) as image:
        decode_small(image)
    return path


def decode_small(image: Image.Image) -> None:
    """Decodes an opened photo, a JPEG at an eighth of its size."""
    image.draft(None, (image.width // 8, image.height // 8))
    with DECODING.of(image):
        image.load()


def load_photo(
    path: Path, factor: float, shift: Shift = STILL, form: PhotoForm = AS_STORED
) -> NDArray[np.uint8]:
    """The image divided by `factor`: uint8 [H, W, 3], sRGB, not writeable.

    Factor 1 is the stored image untouched, but for a colour profile that is not sRGB; any other is
    a Lanczos resampling of it in 8 bits to sizes rounded as `Camera.scaled` does, never of an
    already smaller copy. With a shift, at most 0.5 pixels, it is what `Camera.shifted` sees; the
    photo's edge goes on outside of it.

    Raises:
        SceneError: The pixel data cannot be decoded.
    """
    (pixels,) = load_shifted(path, factor, (shift,), form)
    return pixels


def load_shifted(
    path: Path, factor: float, shifts: Sequence[Shift], form: PhotoForm = AS_STORED
) -> Iterator[NDArray[np.uint8]]:
    """The images of `load_photo` at several shifts; the photo is decoded once, at the first.

    Raises:
        SceneError: The pixel data cannot be decoded.
    """
    with opened_photo(path) as stored, DECODING.of(stored):
        plain = in_8_bits(stored)
        turned = ImageOps.exif_transpose(plain) if form.turned else plain
        if form.mask:
            image = _formed(_as_mask(turned, form.mask), form)
        else:
            image = _formed(in_srgb(_as_rgb(turned), stored.info.get("icc_profile")), form)
        size = scaled_size(*image.size, factor)
        for shift in shifts:
            pixels = _pixels(_resampled(image, size, shift))
            pixels.flags.writeable = False
            yield pixels


def _formed(image: Image.Image, form: PhotoForm) -> Image.Image:
    """An image, turned already, as a pinhole camera sees it."""
    if form.size not in {None, image.size}:
        image = image.resize(form.size or image.size, Image.Resampling.BILINEAR)
    if form.warp is None:
        return image
    pixels, warp = np.asarray(image), form.warp
    if isinstance(warp, Cut):
        return Image.fromarray(cut_view(pixels, warp))
    return Image.fromarray(resample(pixels, warp.pinhole[:2], warp.source))


def _resampled(image: Image.Image, size: tuple[int, int], shift: Shift) -> Image.Image:
    """An image resized to `size` pixels and shifted; untouched if it already is."""
    width, height = image.size
    right, down = shift[0] * width / size[0], shift[1] * height / size[1]
    edge = math.ceil(max(abs(right), abs(down)))
    if edge:
        rows = np.pad(np.asarray(image), ((edge, edge), (edge, edge), (0, 0)), mode="edge")
        image = Image.fromarray(rows)
    box = (edge + right, edge + down, edge + right + width, edge + down + height)
    if not edge and size == image.size:
        return image
    return image.resize(size, Image.Resampling.LANCZOS, box=box)


def _pixels(image: Image.Image) -> NDArray[np.uint8]:
    """The pixels of an RGB image, uint8 [H, W, 3]."""
    pixels = np.empty((image.height, image.width, 3), np.uint8)
    for top, strip in _strips(image):
        pixels[top : top + strip.height] = np.asarray(strip)
    return pixels


def _strips(image: Image.Image) -> Iterator[tuple[int, Image.Image]]:
    """Parts of an image below each other, and their first rows: steps that copy are done on them.

    A whole image is a gigabyte, where every step holds another.
    """
    for top in range(0, image.height, STRIP):
        yield top, image.crop((0, top, image.width, min(top + STRIP, image.height)))


def _as_rgb(image: Image.Image) -> Image.Image:
    """An image as RGB, transparent pixels composited onto black; the image itself if it is RGB."""
    if has_alpha(image):
        whole = Image.new("RGB", image.size)
        for top, strip in _strips(image):
            black = Image.new("RGBA", strip.size, (0, 0, 0, 255))
            whole.paste(Image.alpha_composite(black, strip.convert("RGBA")), (0, top))
        return whole
    return image if image.mode == "RGB" else image.convert("RGB")


def _as_mask(image: Image.Image, kind: str) -> Image.Image:
    """A mask as an RGB image, or the alpha channel of a photo, which is opaque without one.

    A mask of values 0 and 1 becomes black and white.
    """
    if kind == "alpha":
        grey = image.convert("RGBA").getchannel("A") if has_alpha(image) else None
        grey = Image.new("L", image.size, 255) if grey is None else grey
    else:
        grey = _as_rgb(image).convert("L")
    most = grey.getextrema()[1]
    if most == 1:
        grey = grey.point([0, *[255] * 255])
    return grey.convert("RGB")
