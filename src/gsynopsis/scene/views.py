"""What every kind of scene on disk is read into, and the checks they all share."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.photos import expect_size

LONGEST_NAME = 240
"""Characters in an image's name; file systems take 255 bytes a part."""


@dataclass(frozen=True)
class View:
    """One photo.

    Attributes:
        name: Its full name relative to the folder of images, with forward slashes.
        camera: Its camera at full size.
        path: Where it lies.
    """

    name: str
    camera: Camera
    path: Path


@dataclass(frozen=True)
class Listing:
    """What a COLMAP model or a transforms.json says.

    Attributes:
        path: The file that lists the images, for messages.
        views: In any order.
        points: Sparse points, float64 [P, 3], world units.
        colors: Their colours, uint8 [P, 3], sRGB.
        held_out: Names of the test views if the files themselves say so, else None.
        notes: Sentences for `Scene.notes`.
    """

    path: Path
    views: tuple[View, ...]
    points: NDArray[np.float64]  # [P, 3]
    colors: NDArray[np.uint8]  # [P, 3]
    held_out: frozenset[str] | None = None
    notes: tuple[str, ...] = ()


def place_of(listing: Path, folder: Path, name: str) -> Path:
    """Where the image `name` lies: strictly inside `folder`.

    Args:
        listing: The file that names the image, for messages.
        folder: The folder that the name is relative to.
        name: The name with forward slashes, subfolders allowed.

    Raises:
        SceneError: The name is empty or leads out of the folder.
    """
    parts = PurePosixPath(name).parts
    outside = name.startswith("/") or name[1:2] == ":" or ".." in parts or "\\" in name
    odd = any(c < " " or "\ud800" <= c <= "\udfff" for c in name) or len(name) > LONGEST_NAME
    if not parts or outside or odd:
        wanted = f"a name inside {folder}"
        raise SceneError(listing, "image name", found=ascii(name[:80]), expected=wanted)
    return folder.joinpath(*parts)


def spread(positions: NDArray[np.float64]) -> float:
    """Largest distance of points [n, 3] from their mean, in their units; 0 if only rounding."""
    distance = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return distance if distance > 1e-12 * float(np.abs(positions).max()) else 0.0


def check_listing(listing: Listing) -> None:
    """Checks what all scenes must have, the photos by their headers only.

    Raises:
        SceneError: There are no points or one is not finite; there are fewer than two images, an
            image twice, or all cameras in one place; a photo is missing, unreadable or of
            another size than its camera.
    """
    path, views = listing.path, listing.views
    if len(views) < 2:
        advice = "a scene needs photos from several places"
        raise SceneError(path, "images", found=len(views), expected="at least 2", advice=advice)
    if not len(listing.points):
        advice = "the reconstruction is empty: run COLMAP's mapper again"
        raise SceneError(path, "points", found=0, expected="at least 1", advice=advice)
    finite = np.isfinite(listing.points).all(axis=1)
    if not finite.all():
        bad = int(np.flatnonzero(~finite)[0])
        found, wanted = listing.points[bad].tolist(), "finite numbers"
        raise SceneError(path, f"point {bad} xyz", found=found, expected=wanted)
    twice = [a for a, b in pairwise(sorted(view.name for view in views)) if a == b]
    if twice:
        raise SceneError(path, f"image {twice[0]}", found="it twice", expected="each image once")
    if spread(np.stack([view.camera.position for view in views])) == 0:
        wanted = "at least two places"
        raise SceneError(path, "poses", found="all cameras in one place", expected=wanted)
    for view in views:
        expect_size(view.path, (view.camera.width, view.camera.height))
