"""SOG, version 2: attributes as lossless WebP pictures with a `meta.json`, in a folder or a zip."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import SplatFile, check_count, checked, logits_of
from gsynopsis.formats.readers.packed import from_smallest
from gsynopsis.records import HARMONICS, Float32, PlainGaussians

META = "meta.json"
META_MAX = 1 << 22
"""Bytes of a `meta.json`."""
PICTURE_MAX = 1 << 30
"""Stored bytes of a picture."""
VERSION = 2
LARGEST = 252
"""Alpha of a rotation is this and the place of its largest part."""
ROW = 64
"""Centroids of harmonics in a row of their picture."""
BANDS = {3: 1, 8: 2, 15: 3}
PIXELS_SPARE = 8192
"""More pixels than Gaussians there may be: a picture's last row and a little."""

Reader = Callable[[str, int], bytes]
"""Name and most bytes → contents."""
Array = NDArray[Any]


def read_sog(path: Path) -> SplatFile:
    """The Gaussians of a bundled SOG, or of the folder of a `meta.json`.

    Raises:
        InputError: it is damaged, of another version or too large.
    """
    if path.suffix == ".json":
        gaussians, antialiased = read_pictures(in_folder(path.parent), path.name, path)
        return SplatFile((gaussians,), antialiased, kind="SOG")
    try:
        with zipfile.ZipFile(path) as bundle:
            gaussians, antialiased = read_pictures(_in_bundle(bundle, path), META, path)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise InputError(path, found=error, expected="a SOG file") from error
    return SplatFile((gaussians,), antialiased, kind="SOG")


def in_folder(folder: Path) -> Reader:
    """Files of a folder, and of none beside it."""

    def read(name: str, most: int) -> bytes:
        inner = folder / name
        if not inner.resolve().is_relative_to(folder.resolve()):
            raise InputError(inner, found="a path out of the folder", expected="one within")
        try:
            if inner.stat().st_size > most:
                found = f"{inner.stat().st_size:,} bytes"
                raise InputError(inner, found=found, expected=f"at most {most:,}")
            return inner.read_bytes()
        except OSError as error:
            raise InputError(inner, found=error.strerror, expected="a file") from error

    return read


def _in_bundle(bundle: zipfile.ZipFile, path: Path) -> Reader:
    def read(name: str, most: int) -> bytes:
        try:
            info = bundle.getinfo(name)
        except KeyError as error:
            raise InputError(path, name, found="nothing", expected="a file in it") from error
        if info.file_size > most:
            raise InputError(path, name, found=f"{info.file_size:,} bytes", expected=f"{most:,}")
        with bundle.open(info) as file:
            return file.read(most)

    return read


def read_pictures(read: Reader, name: str, path: Path) -> tuple[PlainGaussians, bool]:
    """Gaussians of one SOG, and whether they are anti-aliased.

    Args:
        read: Gives its files.
        name: Of its `meta.json`.
        path: What messages call it.
    """
    meta = parsed(read(name, META_MAX), path)
    try:
        version, count = meta["version"], meta["count"]
        if version != VERSION:
            raise InputError(path, "version", found=version, expected=VERSION)
        if not isinstance(count, int):
            raise InputError(path, "count", found=count, expected="a whole number")
        check_count(count, path, "count")
        source = _Pictures(read, str(Path(name).parent), path, count)
        return checked(_gaussians(meta, source, count), path), bool(meta.get("antialias"))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        found = f"{type(error).__name__}: {error}"
        raise InputError(path, META, found=found, expected="that of a SOG") from error


def parsed(text: bytes, path: Path) -> dict[str, Any]:
    """A JSON object.

    Raises:
        InputError: it is none.
    """
    try:
        meta = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, found=error, expected="JSON") from error
    if not isinstance(meta, dict):
        raise InputError(path, found="other JSON", expected="an object")
    return meta


class _Pictures:
    """The pictures of a SOG; each of `count` pixels or a few more."""

    def __init__(self, read: Reader, folder: str, path: Path, count: int) -> None:
        self.read, self.folder, self.path, self.count = read, folder, path, count

    def pixels(self, name: Any, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """RGBA of each Gaussian [count, 4], or of a picture of a given size [h · w, 4]."""
        data = self.read(name if self.folder == "." else f"{self.folder}/{name}", PICTURE_MAX)
        try:
            with Image.open(io.BytesIO(data), formats=["WEBP", "PNG"]) as image:
                found = image.size
                pixels = found[0] * found[1]
                least = size[0] * size[1] if size else self.count
                good = found == size if size else pixels >= least
                if not good or pixels > 2 * least + PIXELS_SPARE:
                    wanted = f"{size[0]} x {size[1]}" if size else f"about {self.count:,} pixels"
                    shown = f"{found[0]} x {found[1]}"
                    raise InputError(self.path, str(name), found=shown, expected=wanted)
                table = np.asarray(image.convert("RGBA")).reshape(-1, 4)
        except (OSError, Image.DecompressionBombError, SyntaxError) as error:
            raise InputError(self.path, str(name), found=error, expected="a picture") from error
        return table if size else table[: self.count]


def _gaussians(meta: dict[str, Any], source: _Pictures, count: int) -> PlainGaussians:
    low_name, high_name = meta["means"]["files"]
    low, high = (source.pixels(name)[:, :3].astype(np.uint32) for name in (low_name, high_name))
    ends = [np.array(meta["means"][end], np.float64).reshape(3) for end in ("mins", "maxs")]
    logs = ends[0] + (low | high << 8) / 65535 * (ends[1] - ends[0])
    turn = source.pixels(meta["quats"]["files"][0])
    largest = turn[:, 3].astype(np.int64) - LARGEST
    if largest.min() < 0:
        raise ValueError("an alpha of quats below 252")
    first = source.pixels(meta["sh0"]["files"][0])
    scales = _looked_up(meta["scales"]["codebook"], source.pixels(meta["scales"]["files"][0]))
    color = _looked_up(meta["sh0"]["codebook"], first)
    with np.errstate(over="ignore"):
        means = np.sign(logs) * np.expm1(np.abs(logs))
    return PlainGaussians(
        means=means.astype(np.float32),
        log_scales=scales,
        quaternions=from_smallest((turn[:, :3] / 255 - 0.5) * 2**0.5, largest),
        logits=logits_of(first[:, 3] / 255.0),
        sh=np.concatenate([color[:, None], _rest(meta.get("shN"), source, count)], axis=1),
    )


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
    if bands not in BANDS.values() or not 1 <= entries <= 1 << 16:
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
