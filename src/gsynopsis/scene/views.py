"""Records that every kind of scene on disk is read into, and the checks they all share."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.account import Account, listed
from gsynopsis.scene.camera import Camera, positions_of
from gsynopsis.scene.colmap.distortion import warp_of
from gsynopsis.scene.colmap.model import Pinhole
from gsynopsis.scene.outliers import far_cameras
from gsynopsis.scene.photos import AS_STORED, PhotoForm, expect_size
from gsynopsis.scene.ply import GREY, read_ply
from gsynopsis.scene.spheres import VIEWS, Cut, cuts_of
from gsynopsis.scene.splits import SplitLists
from gsynopsis.scene.stored import QUARTER_TURNS, PhotoHeader, profile_notes, read_header

LOST, MISSING, UNPOSED = "with a pose that is not finite", "not on disk", "without a pose"
"""Reasons for which photos are left out."""
RANDOM_POINTS = 10_000
"""Points that stand in where a scene has none."""
CANDIDATES, LOOKING = 10 * RANDOM_POINTS, 60
"""Places that they are chosen of, and cameras at most that choose."""
NEAR = 0.1
"""Depth, in radii of the cameras' ball, up to which a point is right before a camera."""
PARALLAX = 0.01
"""Least spread of cameras beside the distance of the points; handheld photos have 0.1 and more."""
SPHERE_OFF = 0.01
"""Share that the width of a whole sphere may differ from twice its height."""
Place = tuple[float, float, float]
NO_SHIFT: Place = (0.0, 0.0, 0.0)
RESOLVED = 1e4
"""Steps of float32 that cameras are apart, at least; else the scene is moved to the origin."""
LONGEST_NAME = 240
"""Characters in an image's name; file systems take 255 bytes a part."""


@dataclass(frozen=True)
class View:
    """One photo.

    Attributes:
        name: Its full name relative to the folder of images, with forward slashes.
        camera: Its pinhole camera at full size.
        path: Where it lies.
        form: How its pixels become what that camera sees.
        mask: Its mask, see `masks`; None where it has none.
    """

    name: str
    camera: Camera
    path: Path
    form: PhotoForm = AS_STORED
    mask: Path | None = None

    @property
    def stored_size(self) -> tuple[int, int]:
        """Width and height that the stored photo must have, pixels."""
        warp, camera = self.form.warp, self.camera
        width, height = (camera.width, camera.height) if warp is None else warp.size
        return (height, width) if self.form.turned else (width, height)


@dataclass(frozen=True)
class SceneRecords:
    """Contents of a COLMAP model or a transforms.json.

    Attributes:
        path: The file that lists the images, for messages.
        views: In any order.
        points: Sparse points, float64 [P, 3], world units.
        colors: Their colours, uint8 [P, 3], sRGB.
        lists: The split lists in the files; None without any.
        notes: Sentences for `Scene.notes`.
        account: The reader's part of the account.
        up: Away from the ground, not zero; None: as the cameras have it.
        random_points: True if the files have no points, and random ones stand in.
    """

    path: Path
    views: tuple[View, ...]
    points: NDArray[np.float64]  # [P, 3]
    colors: NDArray[np.uint8]  # [P, 3]
    lists: SplitLists | None = None
    notes: tuple[str, ...] = ()
    account: Account = field(default_factory=Account)
    up: tuple[float, float, float] | None = None
    random_points: bool = False


def view_of(
    listing: Path, field: str, place: tuple[str, Path], own: Pinhole, w2c: NDArray[np.float64]
) -> View:
    """A view: its camera fitted to its photo's size, and without distortion.

    A photo may be a smaller or larger copy of what its camera describes; another shape is refused
    later, by `check_listing`. One that is turned by its EXIF tag is so if the camera is.

    Args:
        listing: The file that the camera comes from, for messages.
        field: The camera in it, for messages.
        place: The view's name, and the photo's path.
        own: The camera as the file has it.
        w2c: World to camera, [4, 4].

    Raises:
        SceneError: The lens folds over within the photo, or the photo is missing or unreadable.
    """
    name, path = place
    header = read_header(path)
    width, height = header.size
    turned = header.size != (own.width, own.height) and header.orientation in QUARTER_TURNS
    if turned and same_shape((height, width), (own.width, own.height)):
        width, height = height, width
    else:
        turned = False
    if (width, height) != (own.width, own.height) and same_shape(
        (width, height), (own.width, own.height)
    ):
        own = own.resized(width, height)
    intrinsics = (own.fx, own.fy, own.cx, own.cy)
    warp = warp_of(listing, field, own.lens, (own.width, own.height), intrinsics)
    lens = (own.width, own.height, *intrinsics) if warp is None else warp.pinhole
    form = PhotoForm(turned, warp) if turned or warp else AS_STORED
    return View(name, Camera(*lens, w2c), path, form)


def views_of(
    listing: Path, field: str, place: tuple[str, Path], own: Pinhole, w2c: NDArray[np.float64]
) -> tuple[View, ...]:
    """The views of a photo: of a panorama those that it is cut into, else one, see `view_of`.

    Those of a panorama have its name in folders of their own, `view0/` and so on.
    """
    if not own.sphere:
        return (view_of(listing, field, place, own, w2c),)
    name, path = place
    header = read_header(path)
    size = (
        header.size if same_shape(header.size, (own.width, own.height)) else (own.width, own.height)
    )
    if abs(size[0] - 2 * size[1]) > SPHERE_OFF * size[0]:
        found = f"{size[0]}x{size[1]}"
        raise SceneError(path, "panorama", found=found, expected="the whole sphere, twice as wide")
    views = list[View]()
    for number, cut in enumerate(cuts_of(size)):
        turned = w2c.copy()
        turned[:3] = cut.rotation @ w2c[:3]
        camera = Camera(*cut.pinhole, turned)
        views.append(View(f"view{number}/{name}", camera, path, PhotoForm(warp=cut)))
    return tuple(views)


def photo_name(view: View) -> str:
    """The name of a view's photo; it differs from the view's where that was cut out of it."""
    return view.name.partition("/")[2] if isinstance(view.form.warp, Cut) else view.name


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """True if one image may be a copy of the other at another size, rounded to whole pixels."""
    (width, height), (wide, high) = size, other
    if (width == wide) != (height == high):
        return False
    across, down = abs(height - high * width / wide), abs(width - wide * height / high)
    return min(across, down) <= 1.0 and min(size) > 1


def place_of(listing: Path, folder: Path, name: str) -> Path:
    """Path of the image `name`, strictly inside `folder`.

    Args:
        listing: The file that names the image, for messages.
        folder: The folder that the name is relative to.
        name: The name, subfolders allowed; backslashes, as Windows writes them, divide too.

    Raises:
        SceneError: The name is empty or leads out of the folder.
    """
    place = inner_place(folder, name)
    if place is None:
        found = ascii(name.replace("\\", "/")[:80])
        raise SceneError(listing, "image name", found=found, expected=f"a name inside {folder}")
    return place


def inner_place(folder: Path, name: str) -> Path | None:
    """Path of the image `name` strictly inside `folder`; None if it is empty or leads out."""
    name = name.replace("\\", "/")
    parts = PurePosixPath(name).parts
    outside = name.startswith("/") or name[1:2] == ":" or ".." in parts
    odd = any(c < " " or "\ud800" <= c <= "\udfff" for c in name) or len(name) > LONGEST_NAME
    return folder.joinpath(*parts) if parts and not outside and not odd else None


def spread(positions: NDArray[np.float64]) -> float:
    """Largest distance of points [n, 3] from their mean, in their units; 0 if only rounding."""
    distance = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return distance if distance > 1e-12 * float(np.abs(positions).max()) else 0.0


def near_origin(listing: SceneRecords) -> tuple[SceneRecords, Place]:
    """The listing moved to its origin if float32 could not tell its places apart, and by how much.

    Coordinates of maps (UTM) are so: cameras some metres apart, millions of metres from the origin.
    """
    places = positions_of(view.camera for view in listing.views)
    if len(places) < 2:
        return listing, NO_SHIFT
    middle = np.median(places, axis=0)
    step = float(np.spacing(np.abs(middle).max().astype(np.float32)))
    if spread(places[~far_cameras(places)]) > RESOLVED * step:
        return listing, NO_SHIFT
    x, y, z = (float(value) for value in np.round(middle))
    shift = np.array([x, y, z])
    views = tuple(replace(v, camera=moved(v.camera, -shift)) for v in listing.views)
    note = f"coordinates are moved by minus ({x:.15g} {y:.15g} {z:.15g}), as float32 needs; files "
    note += "note it, and PLY goes back"
    moved_all = replace(listing, views=views, points=listing.points - shift)
    return replace(moved_all, notes=(*listing.notes, note)), (x, y, z)


def moved(camera: Camera, by: NDArray[np.float64]) -> Camera:
    """The camera at another place [3]."""
    w2c = camera.w2c.copy()
    w2c[:3, 3] -= w2c[:3, :3] @ by
    return replace(camera, w2c=w2c)


def with_fallback_points(listing: SceneRecords, found: Path | None = None) -> SceneRecords:
    """The listing with other points where it has none, and a note that says so.

    Args:
        listing: What the files hold.
        found: PLY of points that were found in the photos; where there is none, or no such file,
            random ones stand in.

    Raises:
        SceneError: the PLY is damaged.
    """
    if len(listing.points) or not listing.views:
        return listing
    source = listing.account.source
    told = f"{source} {'have' if ' and ' in source else 'has'} no points"
    if found is not None and found.is_file():
        points, colors = read_ply(found)
        note = f"{told}: {len(points):,} were found in the photos by their poses"
        return replace(listing, points=points, colors=colors, notes=(*listing.notes, note))
    points = _random_points(listing.views)
    note = (
        f"{told}: {len(points)} random ones inside the cameras' bounding sphere stand in for them"
    )
    colors = np.full(points.shape, GREY, np.uint8)
    notes = (*listing.notes, note)
    return replace(listing, points=points, colors=colors, notes=notes, random_points=True)


def _random_points(views: Sequence[View]) -> NDArray[np.float64]:
    """Points where most cameras look, in the smallest ball around their mean with them all, [P, 3].

    Uniform where at least half as many cameras see a point as see any, and none has it right
    before it: there it would hide all else. Cameras far outside of the others do not count.
    """
    places = positions_of(view.camera for view in views)
    places = places[~far_cameras(places)]
    center = places.mean(axis=0)
    radius = np.linalg.norm(places - center, axis=1).max()
    rng = np.random.default_rng(0)
    ray = rng.standard_normal((CANDIDATES, 3))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    points = center + ray * radius * np.cbrt(rng.uniform(size=(CANDIDATES, 1)))
    seen, near = np.zeros(CANDIDATES), np.zeros(CANDIDATES, np.bool_)
    for view in views[:: -(-len(views) // LOOKING)]:
        framed = view.camera.framed(points)
        seen += framed.which
        near[framed.which] |= framed.depths < NEAR * radius
    seen[near] = 0
    order = np.argsort(-np.minimum(seen, seen.max() / 2), kind="stable")
    return points[order[:RANDOM_POINTS]]


def check_listing(listing: SceneRecords) -> tuple[str, ...]:
    """Check the rules of all scenes, photos by their headers only; returns notes on oddities.

    Raises:
        SceneError: There are no points or one is not finite; there are fewer than two images, an
            image twice, or all cameras in one place; a photo is missing, unreadable or of
            another size than its camera.
    """
    path, views = listing.path, listing.views
    if len(views) < 2:
        advice = "a scene needs photos from several places"
        reasons = [f"{len(n)} {why} ({listed(n)})" for why, n in listing.account.left_out.items()]
        found = f"{len(views)} of use, {', '.join(reasons)}" if reasons else len(views)
        raise SceneError(path, "images", found=found, expected="at least 2", advice=advice)
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
    if spread(positions_of(view.camera for view in views)) == 0:
        wanted = "at least two places"
        raise SceneError(path, "poses", found="all cameras in one place", expected=wanted)
    headers = [(view, expect_size(view.path, view.stored_size)) for view in views]
    return tuple(_photo_notes(headers))


def _photo_notes(headers: Sequence[tuple[View, PhotoHeader]]) -> list[str]:
    """Sentences on tags of photos that change how others show them, and are not followed."""
    notes = list[str]()
    turned = [v.name for v, h in headers if h.orientation != 1 and not v.form.turned]
    if turned:
        notes.append(
            f"{len(turned)} photos have an EXIF tag that turns them ({listed(turned)}): it is "
            "ignored, poses are taken for the pixels as stored; if photos are upside down, turn "
            "the pixels (mogrify -auto-orient)"
        )
    cut = {v.path for v, _ in headers if isinstance(v.form.warp, Cut)}
    if cut:
        notes.append(f"{len(cut)} panoramas are cut into {VIEWS} views each, which count as photos")
    return [*notes, *profile_notes(header.colors for _, header in headers)]


def parallax_notes(places: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[str, ...]:
    """A sentence on cameras [n, 3] in nearly one place beside the distance of points [P, 3]."""
    away = np.median(np.linalg.norm(points - places.mean(axis=0), axis=1))
    share = spread(places) / float(away) if away > 0 else 1.0
    if share >= PARALLAX:
        return ()
    return (
        f"all cameras stand in nearly one place (within {share:.1g} of the distance to the "
        "points): there is no parallax, and the scene shows well from there only; take photos "
        "from several places",
    )
