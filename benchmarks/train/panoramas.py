"""A room from panoramas, and from perspective photos of the same places and directions.

    python -m benchmarks.train.panoramas                  # into docs/results/panoramas.csv

The ray caster makes panoramas on a ring, and the views that they are cut into as photos of their
own. Both are trained on, with the same poses, points and settings, and scored on the same held-out
perspective photos from between.
"""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from benchmarks.bench import RESULTS, Row, short_commit, write_rows
from gsynopsis.evaluation.metrics import Image8
from gsynopsis.jobs.train import train
from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.scene.spheres import cuts_of
from gsynopsis.synthetic.make_scene import SyntheticScene, sample_points, world_and_cameras
from gsynopsis.synthetic.raytracer import SUBPIXELS, RayScene, encode_srgb, render, trace

CSV = RESULTS / "panoramas.csv"
RADIUS, HEIGHT, SWING = 2.2, 1.4, 0.2
"""The ring, metres: places stand higher and lower by turns."""
HELD = 8
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        places: Panoramas.
        width: Of a panorama, pixels.
        steps: Of each training.
        seeds: Of trainings.
        csv: Write docs/results/panoramas.csv.
    """

    places: int = 10
    width: int = 512
    steps: int = 600
    seeds: tuple[int, ...] = (0,)
    csv: bool = False


def main() -> None:
    options, rows = tyro.cli(Options, description=__doc__), list[Row]()
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        make(root, options)
        for seed in options.seeds:
            for kind in ("panoramas", "perspective"):
                run = train(
                    root / kind,
                    out=root / f"run-{kind}-{seed}",
                    steps=options.steps,
                    settings={"train.seed": seed, "train.exposure": "off"},
                )
                assert run.report is not None
                psnr = run.report.levels[-1].quality.psnr_full
                rows.append({"photos": kind, "seed": seed, "psnr": round(psnr, 3)})
                rows[-1] |= {"places": options.places, "steps": options.steps}
                rows[-1] |= {"commit": short_commit()}
                print(rows[-1], flush=True)
    if options.csv:
        write_rows(CSV, rows)


def make(root: Path, options: Options) -> None:
    """Both scenes, each with the same held-out photos and points."""
    recipe = SyntheticScene("room", 8, 240, 160, 0, 6000)
    world, around = world_and_cameras(recipe)
    places = sample_points(recipe, world, around)
    poses = [pose_at(2 * np.pi * k / options.places, k) for k in range(options.places)]
    side = cuts_of((options.width, options.width // 2))[0].pinhole
    tests = [Camera(*side, pose_at(2 * np.pi * (k + 0.37) / HELD, k + 1)) for k in range(HELD)]
    held = [(f"test_{k}.png", camera) for k, camera in enumerate(tests)]
    for kind in ("panoramas", "perspective"):
        folder = root / kind
        (folder / "images").mkdir(parents=True)
        frames = [perspective(folder, world, name, camera) for name, camera in held]
        for number, pose in enumerate(poses):
            if kind == "panoramas":
                frames.append(sphere(folder, world, f"pano_{number}.png", pose, options.width))
                continue
            for view, cut in enumerate(cuts_of((options.width, options.width // 2))):
                turned = pose.copy()
                turned[:3] = cut.rotation @ pose[:3]
                name, camera = f"pano_{number}_{view}.png", Camera(*cut.pinhole, turned)
                frames.append(perspective(folder, world, name, camera))
        names = [frame["file_path"] for frame in frames]
        lists = {"train_filenames": names[HELD:], "test_filenames": names[:HELD]}
        document = {**lists, "ply_file_path": "points.ply", "frames": frames}
        (folder / "transforms.json").write_text(json.dumps(document))
        write_points(folder / "points.ply", *places)


def pose_at(angle: float, number: int) -> Float64:
    """World to camera of an upright camera on the ring that looks somewhere."""
    place = np.array([RADIUS * np.cos(angle), RADIUS * np.sin(angle), HEIGHT])
    place[2] += SWING * (number % 3 - 1)
    look = 2.3 * angle + number
    ahead = place + np.array([np.cos(look), np.sin(look), 0.0])
    return look_at(place, ahead, np.array([0.0, 0.0, 1.0]))


def perspective(folder: Path, world: RayScene, name: str, camera: Camera) -> Row:
    """A photo, written, and its frame."""
    Image.fromarray(render(world, camera)).save(folder / "images" / name)
    lens = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
    lens |= {"cx": camera.cx, "cy": camera.cy, "camera_model": "OPENCV"}
    return {**lens, **frame_of(name, camera.w2c)}


def sphere(folder: Path, world: RayScene, name: str, pose: Float64, width: int) -> Row:
    """A panorama, written, and its frame."""
    Image.fromarray(sphere_photo(world, pose, width)).save(folder / "images" / name)
    return {"w": width, "h": width // 2, "camera_model": "EQUIRECTANGULAR", **frame_of(name, pose)}


def frame_of(name: str, w2c: Float64) -> Row:
    """Name and OpenGL matrix."""
    matrix = np.linalg.inv(w2c) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return {"file_path": f"images/{name}", "transform_matrix": matrix.tolist()}


def sphere_photo(world: RayScene, w2c: Float64, width: int) -> Image8:
    """An equirectangular photo, uint8 [width / 2, width, 3], four samples a pixel."""
    height = width // 2
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    origin = (-w2c[:3, :3].T @ w2c[:3, 3]).astype(np.float32)[:, None]
    light = np.zeros((3, width * height), np.float32)
    for sample, (right, down) in enumerate(SUBPIXELS):
        lon = ((x.ravel() + right) / width - 0.5) * 2 * np.pi
        lat = ((y.ravel() + down) / height - 0.5) * np.pi
        local = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)])
        ray = (w2c[:3, :3].T @ local).astype(np.float32)
        rays = (np.broadcast_to(origin, ray.shape), ray)
        light += trace(world, rays, 2 * np.pi / width, sample)[0]
    return encode_srgb(light.T / len(SUBPIXELS)).reshape(height, width, 3)


def write_points(path: Path, places: Float64, colors: NDArray[np.uint8]) -> None:
    """A PLY of points."""
    fields = [f"property float {axis}" for axis in "xyz"]
    fields += [f"property uchar {shade}" for shade in ("red", "green", "blue")]
    head = ["ply", "format ascii 1.0", f"element vertex {len(places)}", *fields, "end_header"]
    pairs = zip(places.tolist(), colors.tolist(), strict=True)
    rows = [" ".join(map(str, [*place, *color])) for place, color in pairs]
    path.write_text("\n".join([*head, *rows]) + "\n")


if __name__ == "__main__":
    main()
