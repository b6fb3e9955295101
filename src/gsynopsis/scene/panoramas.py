"""Panoramas: how they are known, and what to do with those that cannot be cut, see `spheres`."""

import re

import numpy as np
from PIL import Image

from gsynopsis.scene.stored import DECODE_ERRORS, exif_of

CUT = (
    "cut each into perspective photos, such as with ffmpeg -i P.jpg -vf "
    "v360=e:flat:yaw=0:h_fov=90:v_fov=90:w=1024:h=1024 P_0.jpg and so on for yaw 60, 120, 180, "
    "-120 and -60"
)
NOT_ONE = f"{CUT}; or, if they are none, crop them to another shape than 2:1"
CUT_POSED = f"{CUT}; then give the new photos alone, their poses are estimated"
PROJECTION = re.compile(rb"ProjectionType\W{1,12}(equirectangular|cylindrical|fisheye)", re.I)
"""In XMP: Google's GPano, which cameras and stitching programs write."""
CUSTOM, STITCHED = 0xA401, 6
"""EXIF's tag CustomRendered, and the value with which phones mark a panorama."""
OFF = 0.002
"""Share that the width of a whole sphere may differ from twice its height."""
LEAST = 32
"""Least height of a panorama, pixels."""
FOCAL, FOCAL_35 = 0x920A, 0xA405
"""EXIF's tags of focal lengths."""
LOOKED = (128, 64)
"""Largest size of the grey copy whose sides are compared, pixels."""
MEET = 2.0
"""Sides meet if they differ by no more than this many times what neighbouring columns do."""


def is_panorama(image: Image.Image, *, shaped: bool, filmed: bool) -> bool:
    """True if a photo, opened and perhaps decoded at a smaller size, is to be taken for a panorama.

    It is one by its own metadata or by its shape. A photo of that shape counts as perspective only
    if its sides do not meet, and it has a focal length or is a frame of a video, which phones film
    in that shape.

    Args:
        image: The photo.
        shaped: It has that shape as stored, see `is_wide`.
        filmed: It is a frame of a video.
    """
    if has_panorama_tag(image):
        return True
    if not shaped:
        return False
    return wraps_around(image) if filmed or has_focal_length(image) else True


def is_sphere(image: Image.Image) -> bool:
    """True if a panorama of that shape is of the whole sphere: its sides meet, no tag says else.

    Decodes it.
    """
    said = PROJECTION.search(_xmp(image))
    whole = said is None or said[1].lower() == b"equirectangular"
    return whole and wraps_around(image)


def has_panorama_tag(image: Image.Image) -> bool:
    """True if a photo's XMP or EXIF call it a panorama; nothing is decoded."""
    told = PROJECTION.search(_xmp(image)) is not None
    return told or _detail(image).get(CUSTOM) == STITCHED


def _xmp(image: Image.Image) -> bytes:
    notes = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
    text = notes.encode("utf-8", "replace") if isinstance(notes, str) else notes
    return text if isinstance(text, bytes) else b""


def has_focal_length(image: Image.Image) -> bool:
    """True if EXIF has a focal length."""
    return any(_detail(image).get(tag) for tag in (FOCAL, FOCAL_35))


def _detail(image: Image.Image) -> dict[int, object]:
    try:
        return dict(exif_of(image).get_ifd(0x8769))
    except DECODE_ERRORS:
        return {}


def is_wide(image: Image.Image) -> bool:
    """True if a photo has the shape of a whole sphere."""
    off = abs(image.width - 2 * image.height)
    return image.height >= LEAST and off <= max(1.0, OFF * image.width)


def wraps_around(image: Image.Image) -> bool:
    """True if the right side of a photo continues at its left one; decodes it."""
    size = min(LOOKED[0], image.width), min(LOOKED[1], image.height)
    grey = np.asarray(image.convert("L").resize(size, Image.Resampling.BOX), np.float32)
    across = float(np.abs(grey[:, 0] - grey[:, -1]).mean())
    beside = float(np.abs(np.diff(grey, axis=1)).mean())
    return across <= MEET * beside + 1
