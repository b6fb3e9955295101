"""SOG: attributes as lossless WebP images with a `meta.json`, in a folder or a zip.

In version 2 values are entries of codebooks; version 1 says no version and has them between bounds.
"""

import io
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import (
    SplatFile,
    check_count,
    check_ratio,
    cleaned,
    logits_of,
    shown,
)
from gsynopsis.formats.readers.opening import Bundle, Files, parsed
from gsynopsis.formats.readers.packed import from_smallest
from gsynopsis.records import HARMONICS, Float32, PlainGaussians

META = "meta.json"
META_MAX = 1 << 22
"""Bytes of a `meta.json`."""
VERSIONS = (1, 2)
LARGEST = 252
"""Alpha of a rotation is this and the place of its largest part."""
ROW = 64
"""Centroids of harmonics in a row of their image."""
BANDS = {3: 1, 8: 2, 15: 3}
PIXELS_SPARE = 8192
"""Pixels that an image may have beyond the Gaussians: its last row and a little."""
PIXEL_BYTES = 8
"""Most bytes of a stored image for each pixel it may have: lossless ones take 4 and less."""
NAMES_MAX = 16
"""Images of a SOG."""
CENTROIDS_MAX = 1 << 16
"""Centroids of harmonics, few splats or many: their image may be larger than the others."""
FOREIGN = (ArithmeticError, LookupError, TypeError, ValueError, AttributeError, RecursionError)
"""Errors of values of other types and sizes than a `meta.json` has."""

Array = NDArray[Any]


def sog_of(files: Files, name: str, path: Path) -> SplatFile:
    """The Gaussians of a SOG.

    Args:
        files: Where its files are.
        name: Of its `meta.json`.
        path: What messages call it.

    Raises:
        InputError: it is damaged, of another version or too large.
    """
    gaussians, antialiased = read_pictures(files, name, path)
    return cleaned(SplatFile((gaussians,), antialiased, kind="SOG"), path)


@contextmanager
def bundled(file: BinaryIO, path: Path) -> Iterator[Bundle]:
    """The files of a zip, for one `with` block.

    Raises:
        InputError: it is damaged, also if that shows only when its files are read.
    """
    try:
        size = file.seek(0, 2)
        with zipfile.ZipFile(file) as bundle:
            yield Bundle(bundle, path, size)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, struct.error) as error:
        raise InputError(path, found=shown(error), expected="a whole zip") from error


def read_pictures(
    files: Files, name: str, path: Path, before: int = 0
) -> tuple[PlainGaussians, bool]:
    """Gaussians of one SOG, unchecked, and whether they are anti-aliased.

    Args:
        files: Where its files are.
        name: Of its `meta.json`.
        path: What messages call it.
        before: Gaussians that were read from the same files already.

    Raises:
        InputError: it is damaged, of another version or too large.
    """
    meta = parsed(files.read(name, META_MAX), path)
    try:
        version = meta.get("version", 1)
        if version not in VERSIONS or isinstance(version, bool):
            expected = " or ".join(map(str, VERSIONS))
            raise InputError(path, "version", found=shown(version), expected=expected)
        count = meta["count"] if version > 1 else meta["means"]["shape"][0]
        if type(count) is not int:
            raise InputError(path, "count", found=shown(count), expected="a whole number")
        check_count(count, path, "count")
        source = _Pictures(files, str(Path(name).parent), path, count)
        source.fetch(meta)
        check_ratio(before + count, files.stored, path)
        antialiased = bool(meta.get("antialias"))
        return (_gaussians if version > 1 else _former)(meta, source, count), antialiased
    except FOREIGN as error:
        found = shown(f"{type(error).__name__}: {error}")
        raise InputError(path, name, found=found, expected="that of a SOG") from error


class _Pictures:
    """The images of a SOG; each of `count` pixels or a few more."""

    def __init__(self, files: Files, folder: str, path: Path, count: int) -> None:
        self.files, self.folder, self.path, self.count = files, folder, path, count
        self.stored: dict[str, bytes] = {}

    def fetch(self, meta: dict[str, Any]) -> None:
        """Read all images as stored: their possible size is measured by their bytes."""
        parts = [part for part in meta.values() if isinstance(part, dict)]
        names = [name for part in parts for name in part.get("files", ())]
        if len(names) > NAMES_MAX:
            raise ValueError(f"{len(names)} pictures")
        largest = max(self.most(self.count), CENTROIDS_MAX * max(BANDS))
        for name in names:
            inner = name if self.folder == "." else f"{self.folder}/{name}"
            self.stored[name] = self.files.read(inner, PIXEL_BYTES * largest)

    @staticmethod
    def most(least: int) -> int:
        """Pixels of an image that has to have some."""
        return 2 * least + PIXELS_SPARE

    def pixels(self, name: Any, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """RGBA of each Gaussian [count, 4], or of an image of a given size [h · w, 4]."""
        data = self.stored[name]
        try:
            with Image.open(io.BytesIO(data), formats=["WEBP", "PNG"]) as image:
                found = image.size
                pixels = found[0] * found[1]
                least = size[0] * size[1] if size else self.count
                good = found == size if size else pixels >= least
                if not good or pixels > self.most(least):
                    wanted = f"{size[0]} x {size[1]}" if size else f"about {self.count:,} pixels"
                    text = f"{found[0]} x {found[1]}"
                    raise InputError(self.path, shown(name), found=text, expected=wanted)
                table = np.asarray(image.convert("RGBA")).reshape(-1, 4)
        except (OSError, Image.DecompressionBombError, SyntaxError) as error:
            found = shown(error)
            raise InputError(self.path, shown(name), found=found, expected="a picture") from error
        return table if size else table[: self.count]

    def centroids(self, names: Any) -> dict[str, int]:
        """Bands and number of the centroids of an image, by its size."""
        with Image.open(io.BytesIO(self.stored[names[0]]), formats=["WEBP", "PNG"]) as image:
            return {"bands": BANDS[image.width // ROW], "count": ROW * image.height}


def _gaussians(meta: dict[str, Any], source: _Pictures, count: int) -> PlainGaussians:
    first = source.pixels(meta["sh0"]["files"][0])
    scales = _looked_up(meta["scales"]["codebook"], source.pixels(meta["scales"]["files"][0]))
    color = _looked_up(meta["sh0"]["codebook"], first)
    return PlainGaussians(
        means=_means(meta["means"], source),
        log_scales=scales,
        quaternions=_rotations(meta["quats"], source),
        logits=logits_of(first[:, 3] / 255.0),
        sh=np.concatenate([color[:, None], _rest(meta.get("shN"), source, count)], axis=1),
    )


def _former(meta: dict[str, Any], source: _Pictures, count: int) -> PlainGaussians:
    """Those of version 1."""
    scales = _between(meta["scales"], source.pixels(meta["scales"]["files"][0])[:, :3])
    first = _between(meta["sh0"], source.pixels(meta["sh0"]["files"][0]))
    rest = meta.get("shN")
    if rest is not None:
        # One pair of bounds for all; bands and centroids follow from the picture.
        low, high = float(rest["mins"]), float(rest["maxs"])
        rest = {**rest, "codebook": np.linspace(low, high, 256), **source.centroids(rest["files"])}
    return PlainGaussians(
        means=_means(meta["means"], source),
        log_scales=scales,
        quaternions=_rotations(meta["quats"], source),
        logits=first[:, 3].copy(),
        sh=np.concatenate([first[:, None, :3], _rest(rest, source, count)], axis=1),
    )


def _means(meta: Any, source: _Pictures) -> Float32:
    low, high = (source.pixels(name)[:, :3].astype(np.uint32) for name in meta["files"])
    logs = _ends(meta, (low | high << 8) / 65535)
    return (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32)


def _rotations(meta: Any, source: _Pictures) -> Float32:
    turn = source.pixels(meta["files"][0])
    largest = turn[:, 3].astype(np.int64) - LARGEST
    if largest.min() < 0:
        raise ValueError("an alpha of quats below 252")
    return from_smallest((turn[:, :3] / 255 - 0.5) * 2**0.5, largest)


def _ends(meta: Any, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values between the bounds of their column."""
    width = share.shape[1]
    low, high = (np.array(meta[end], np.float64).reshape(width) for end in ("mins", "maxs"))
    return low + share * (high - low)


def _between(meta: Any, pixels: NDArray[np.uint8]) -> Float32:
    return _ends(meta, pixels / 255).astype(np.float32)


def _looked_up(codebook: Any, pixels: NDArray[np.uint8]) -> Float32:
    """Values of the first three channels in a codebook of at most 256."""
    table = np.array(codebook, np.float32).reshape(-1)
    most = int(pixels[:, :3].max(initial=0))
    if most >= len(table):
        raise ValueError(f"a codebook of {len(table)} entries, and an index of {most}")
    return table[pixels[:, :3]]


def _rest(meta: Any, source: _Pictures, count: int) -> Float32:
    """Harmonics beyond the first, [G, C - 1, 3]: centroids by label."""
    if meta is None:
        return np.zeros((count, 0, 3), np.float32)
    bands, entries = meta["bands"], meta["count"]
    if bands not in BANDS.values() or not 1 <= entries <= CENTROIDS_MAX:
        raise ValueError(f"{bands} bands of {entries} centroids")
    each = HARMONICS[bands] // 3
    pictures = meta["files"]
    size = (ROW * each, -(-entries // ROW))
    centroids = _looked_up(meta["codebook"], source.pixels(pictures[0], size))
    centroids = centroids.reshape(-1, each, 3)[:entries]
    pixels = source.pixels(pictures[1]).astype(np.int64)
    labels = pixels[:, 0] | pixels[:, 1] << 8
    if int(labels.max()) >= entries:
        raise ValueError(f"a label of {labels.max()} of {entries} centroids")
    return centroids[labels]
