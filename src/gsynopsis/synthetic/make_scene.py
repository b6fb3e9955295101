"""Seeded procedural scenes in COLMAP layout, so that they take the road of real photos.

The images come from the ray caster; the sparse points are where random rays of the photos hit,
with the colours seen there. The same arguments give the same bytes.
"""

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.errors import SettingError, SpaceError
from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.model import Pinhole, Pose, SparseModel, quaternion_from_rotation
from gsynopsis.synthetic import city, room
from gsynopsis.synthetic import garden as outdoor
from gsynopsis.synthetic import product as studio
from gsynopsis.synthetic.raytracer import (
    SUBPIXELS,
    RayScene,
    camera_rays,
    encode_srgb,
    render,
    trace,
)

Kind = Literal["room", "outdoor", "object", "city"]
MARK = "synthetic.json"
"""The file that marks a folder as made here, with the recipe."""
FOCAL = 0.85
"""Focal length over image width: 61° across."""
ORBITS = {"room": room.ORBIT, "outdoor": outdoor.ORBIT, "object": studio.ORBIT, "city": city.PITCH}
"""Radius of the ring of cameras, metres; of the city the distance between streets."""
EYES = {"room": (1.5, 0.35, 0.9), "outdoor": (1.35, 0.4, 1.0), "object": (1.2, 0.5, 0.78)}
"""Mean height of the cameras, its swing, and the height they look at, metres."""
UP = np.array([0.0, 0.0, 1.0])
SWINGS = 3
"""Number of times that the cameras go up and down on their way round."""
FAR = {"room": 100.0, "outdoor": 100.0, "object": 0.9, "city": 0.9 * city.DOME}
"""Orbit radii beyond which only the sky is, or the backdrop."""
SKY_SHARE = {"room": 0.25, "outdoor": 0.25, "object": 0.0, "city": 0.25}
"""Share of the points sampled there that is kept: a reconstruction finds few in the sky, and none
where all is of one colour."""
LARGEST_SIDE = 4096
QUICK_PNG = 4
"""Less than half of the time that zlib takes at its usual 6, for photos 5 % larger."""
MOST_THREADS = 8
"""Photos that are taken at once, each in some 50 MB."""


@dataclass(frozen=True)
class SyntheticScene:
    """Recipe of a scene; the arguments of `make_scene`."""

    kind: Kind
    views: int
    width: int
    height: int
    seed: int
    points: int


def make_scene(  # noqa: PLR0913 -- flat keywords, as people call it
    kind: Kind,
    out: Path | str,
    *,
    views: int = 40,
    width: int = 240,
    height: int = 160,
    seed: int = 0,
    points: int = 6000,
    tick: Callable[[int, int], None] | None = None,
) -> Path:
    """Renders a procedural scene into the folder `out` and returns it.

    Args:
        kind: `room` (furnished, a mirror ball in its middle), `outdoor` (a garden with hills
            at 32 to 62 and a sky at 110 times the radius of the cameras' ring), `object` (a
            figure before a plain backdrop, on which there are no points), or `city` (a block of
            houses for about every ten photos, seen from above its streets).
        out: Where to. An earlier output of this function is replaced; another folder that is
            not empty is refused.
        views: Number of photos, 2 to 10,000.
        width: Their width, pixels.
        height: Their height, pixels.
        seed: Seed of textures, cameras and points, ≥ 0.
        points: Number of sparse points, 1 to 10,000,000; fewer where that many are not found.
        tick: Told after each photo how many there are, and of how many.

    Raises:
        SettingError: An argument is out of range, or `out` holds something else.
        SpaceError: The disk is full.

    Examples:
        >>> folder = gs.make_scene("room", "scene", views=12, width=96, height=64)
        >>> sorted(entry.name for entry in folder.iterdir())
        ['images', 'sparse', 'synthetic.json']
    """
    out = Path(out)
    recipe = SyntheticScene(kind, views, width, height, seed, points)
    _check_recipe(recipe)
    _check_folder(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as part:
            made = Path(part) / out.name
            _write(made, recipe, tick)
            if out.exists():
                shutil.rmtree(out)
            made.rename(out)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise SpaceError(out, found="a full disk", expected="room for the photos") from error
        raise SettingError(out, found=error.strerror, expected="a writable folder") from error
    return out


def world_and_cameras(recipe: SyntheticScene) -> tuple[RayScene, list[Camera]]:
    """The world of a recipe and cameras: over the streets, or on a ring, looking inwards."""
    if recipe.kind == "city":
        grid = city.grid_of(recipe.views)
        places = city.flight(recipe.views, grid, recipe.seed)
        return city.world(recipe.seed * 1000, grid), [_camera(recipe, *place) for place in places]
    worlds = {"room": room.world, "outdoor": outdoor.world, "object": studio.world}
    return worlds[recipe.kind](recipe.seed * 1000), _ring(recipe)


def _ring(recipe: SyntheticScene) -> list[Camera]:
    """Cameras on a ring that goes up and down, looking inwards."""
    rng = np.random.default_rng(recipe.seed)
    radius, (eye, swing, look) = ORBITS[recipe.kind], EYES[recipe.kind]
    cameras: list[Camera] = []
    for angle in np.arange(recipe.views) * (2 * np.pi / recipe.views):
        wobble = rng.uniform(-1, 1, 5)
        reach = radius * (1 + 0.05 * wobble[0])
        level = eye + swing * np.sin(SWINGS * angle) + 0.1 * wobble[1]
        position = np.array([reach * np.cos(angle), reach * np.sin(angle), level])
        target = np.array([0, 0, look]) + 0.12 * wobble[2:]
        cameras.append(_camera(recipe, position, target))
    return cameras


def _camera(
    recipe: SyntheticScene, position: NDArray[np.float64], target: NDArray[np.float64]
) -> Camera:
    focal = FOCAL * recipe.width
    middle = (recipe.width / 2, recipe.height / 2)
    w2c = look_at(position, target, UP)
    return Camera(recipe.width, recipe.height, focal, focal, *middle, w2c)


def sample_points(
    recipe: SyntheticScene, world: RayScene, cameras: Sequence[Camera]
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points where random rays of the cameras hit, float64 [P, 3], and their colours [P, 3]."""
    rng = np.random.default_rng([recipe.seed, 1])
    total = 2 * recipe.points
    view = np.sort(rng.integers(len(cameras), size=total))
    pixels = rng.uniform(0, 1, (total, 2)) * (recipe.width, recipe.height)
    places, colors = np.empty((total, 3)), np.empty((total, 3), np.uint8)
    for number, camera in enumerate(cameras):
        mine = view == number
        if not mine.any():
            continue
        rays = camera_rays(camera, pixels[mine])
        seen = [trace(world, rays, 1 / camera.fx, k) for k in range(len(SUBPIXELS))]
        colors[mine] = encode_srgb(np.mean([s[0] for s in seen], axis=0).T)
        places[mine] = (rays[0] + seen[0][1] * rays[1]).T
    sky = np.linalg.norm(places, axis=1) > FAR[recipe.kind] * ORBITS[recipe.kind]
    spared = sky & (rng.uniform(size=total) > SKY_SHARE[recipe.kind])
    order = rng.permutation(total)
    chosen = order[np.argsort(spared[order], kind="stable")][: recipe.points]
    if not SKY_SHARE[recipe.kind] and not sky.all():
        chosen = chosen[~sky[chosen]]
    return places[chosen], colors[chosen]


def _write(folder: Path, recipe: SyntheticScene, tick: Callable[[int, int], None] | None) -> None:
    world, cameras = world_and_cameras(recipe)
    (folder / "images").mkdir(parents=True)
    poses: list[Pose] = []

    def take(number: int) -> None:
        photo = Image.fromarray(render(world, cameras[number]))
        photo.save(folder / "images" / _name(number), compress_level=QUICK_PNG)

    # NumPy lets other threads run while it computes.
    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
        for done, _ in enumerate(pool.map(take, range(len(cameras))), start=1):
            if tick is not None:
                tick(done, len(cameras))
    for number, camera in enumerate(cameras):
        quaternion = quaternion_from_rotation(camera.w2c[:3, :3])
        x, y, z = camera.w2c[:3, 3].tolist()
        poses.append(Pose(_name(number), 1, quaternion, (x, y, z)))
    c = cameras[0]
    lens = {1: Pinhole(c.width, c.height, c.fx, c.fy, c.cx, c.cy)}
    points, colors = sample_points(recipe, world, cameras)
    write_binary(folder / "sparse" / "0", SparseModel(lens, tuple(poses), points, colors))
    (folder / MARK).write_text(json.dumps(asdict(recipe), indent=2) + "\n")


def _name(number: int) -> str:
    return f"view_{number:04d}.png"


def _check_recipe(recipe: SyntheticScene) -> None:
    if recipe.kind not in get_args(Kind):
        raise SettingError("kind", found=recipe.kind, expected=" or ".join(get_args(Kind)))
    limits = {
        "views": (2, 10_000),
        "width": (1, LARGEST_SIDE),
        "height": (1, LARGEST_SIDE),
        "seed": (0, 2**31),
        "points": (1, 10_000_000),
    }
    for name, (low, high) in limits.items():
        value = getattr(recipe, name)
        if not low <= value <= high:
            raise SettingError(name, found=value, expected=f"{low} to {high}")


def _check_folder(out: Path) -> None:
    """Refuses to replace anything but what `make_scene` wrote itself."""
    if not out.exists():
        return
    files = {p.relative_to(out).as_posix() for p in out.rglob("*") if not p.is_dir()}
    if out.is_dir() and files <= _own_files(out / MARK):
        return
    raise SettingError(
        out,
        found="a folder with other files" if out.is_dir() else "a file",
        expected="a new or empty folder, or an earlier synthetic scene",
        advice="choose another folder",
    )


def _own_files(mark: Path) -> set[str]:
    """Files of the scene that a mark describes; none if there is no such mark."""
    try:
        recipe = cast(dict[str, Any], json.loads(mark.read_text()))
        views = min(int(recipe["views"]), 10_000)
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    model = {f"sparse/0/{name}.bin" for name in ("cameras", "images", "points3D")}
    return {MARK} | model | {f"images/{_name(number)}" for number in range(views)}
