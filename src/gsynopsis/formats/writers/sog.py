"""SOG, version 2: attributes as lossless WebP images with a `meta.json`, in a folder or a zip.

Ours, because gaussforge 0.6 and others without a GPU look through all centroids of harmonics for
each splat: 72,619 splats of degree 3 were not written after six minutes, 40,000 in twelve seconds.
"""

import io
import json
import zipfile
from collections.abc import Mapping
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.formats.readers.sog import BANDS, LARGEST, META, ROW
from gsynopsis.formats.writers.codebooks import value_codebook, vector_codebook
from gsynopsis.formats.writers.packed import neighbours, smallest_three
from gsynopsis.records import Float32, PlainGaussians

PALETTE = (1 << 10, 1 << 16)
"""Fewest and most centroids of harmonics."""
SHARE = 4
"""Most splats for each centroid of harmonics; their number is the next power of two (ours)."""
MULTIPLE = 4
"""Sides of images are multiples of this, as in files of splat-transform."""

Pixels = NDArray[np.uint8]


def sog_bytes(gaussians: PlainGaussians, *, antialiased: bool = False) -> bytes:
    """The files of `sog_files` as one file `.sog`."""
    return zipped(sog_files(gaussians, antialiased=antialiased))


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A folder as one file, `.sog` or `.ssog`, stored: images are compressed already."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return stream.getvalue()


def sog_files(gaussians: PlainGaussians, *, antialiased: bool = False) -> dict[str, bytes]:
    """All files of the folder by name; rows are in Morton order of their positions.

    Args:
        gaussians: At least one.
        antialiased: They are to be drawn so.
    """
    g, order = gaussians, neighbours(gaussians.means)
    means = g.means[order].astype(np.float64)
    logs = np.sign(means) * np.log1p(np.abs(means))
    low, high = logs.min(axis=0), logs.max(axis=0)
    share = (logs - low) / np.where(high > low, high - low, 1)
    positions = np.rint(share * 65535).astype(np.uint16)
    scale_book, scales = value_codebook(g.log_scales[order])
    color_book, colors = value_codebook(g.sh[order, 0])
    opacity = 1 / (1 + np.exp(-g.logits[order].astype(np.float64)))
    small, largest = smallest_three(g.quaternions[order].astype(np.float64))
    turns = np.clip(np.rint((small / 2**0.5 + 0.5) * 255), 0, 255)
    files = {
        "means_l.webp": _image(positions & 255),
        "means_u.webp": _image(positions >> 8),
        "scales.webp": _image(scales),
        "quats.webp": _image(np.concatenate([turns, LARGEST + largest[:, None]], axis=1)),
        "sh0.webp": _image(np.concatenate([colors, np.rint(opacity * 255)[:, None]], axis=1)),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": "gsynopsis"},
        "count": len(order),
        **({"antialias": True} if antialiased else {}),
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_book.tolist(), "files": ["sh0.webp"]},
    }
    rest = g.sh[order, 1:]
    if rest.shape[1] in BANDS and rest.any():
        meta["shN"], images = _harmonics(rest)
        files |= images
    return {META: json.dumps(meta).encode(), **files}


def _harmonics(rest: Float32) -> tuple[dict[str, Any], Mapping[str, bytes]]:
    """Their part of `meta.json` and their images: centroids, 64 in a row, and labels.

    Args:
        rest: Coefficients beyond the first [G, C - 1, 3].
    """
    count, each = rest.shape[:2]
    fewest, most = PALETTE
    entries = min(most, max(fewest, 1 << (count // SHARE).bit_length()))
    centroids, labels = vector_codebook(rest.reshape(count, -1), entries)
    book, places = value_codebook(centroids)
    rows = -(-len(centroids) // ROW)
    table = np.zeros((rows * ROW, each, 3), np.uint8)
    table[: len(centroids)] = places.reshape(-1, each, 3)
    images = {
        "shN_centroids.webp": _webp(table.reshape(rows, ROW * each, 3)),
        "shN_labels.webp": _image(np.stack([labels & 255, labels >> 8, 0 * labels], axis=1)),
    }
    part = {
        "count": len(centroids),
        "bands": BANDS[each],
        "codebook": book.tolist(),
        "files": list(images),
    }
    return part, images


def _image(pixels: NDArray[Any]) -> bytes:
    """A WebP image of a pixel for each row [G, 3 or 4] of whole numbers below 256."""
    count, channels = pixels.shape
    width = MULTIPLE * ceil(count**0.5 / MULTIPLE)
    height = MULTIPLE * ceil(count / width / MULTIPLE)
    whole = np.zeros((height * width, channels), np.uint8)
    whole[:count] = pixels
    if channels == 4:
        whole[count:, 3] = LARGEST
    return _webp(whole.reshape(height, width, channels))


def _webp(image: Pixels) -> bytes:
    stream = io.BytesIO()
    # `exact` keeps colours where alpha, here a number like the others, is 0.
    Image.fromarray(image).save(stream, "WEBP", lossless=True, quality=100, method=4, exact=True)
    return stream.getvalue()
