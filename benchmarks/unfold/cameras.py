"""Cameras found from splats alone against those the scene was photographed with.

    python -m benchmarks.unfold.cameras OUT fox brighton --data ../shared/data

Of each scene 3DGS is trained on its photos, 2,000 steps, and written as OUT/NAME/input.ply, if
that is not there. Then: degrees between its up and the one that was found; decibels of each level
that an import makes from found cameras, and from the true ones, both in pictures from the true
ones; the share of what the true cameras show that the found ones see. What a difference of cameras
costs at all tells a third import: from the true ones, each a quarter farther from what all look at.
Scenes that are not there are skipped.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import torch

from benchmarks.unfold.known import trained
from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.cameras.orbit import nearest_to_axes
from gsynopsis.cameras.placement import shown
from gsynopsis.cameras.up import up_of_cameras
from gsynopsis.cameras.viewpoints import Viewpoints, for_splats
from gsynopsis.errors import InputError
from gsynopsis.formats.axes import DOWN
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.jobs.import_splats import (
    GAIN_VIEWS,
    ROUNDING,
    counts_of,
    measured,
    ranking_and_quality,
    splat_model,
    with_gains,
)
from gsynopsis.jobs.splat_views import painted
from gsynopsis.model.splat_levels import splat_levels
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.render.base import Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.measures import blend_weights
from gsynopsis.scene.camera import Camera, positions_of
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.teacher.ranking import worth_of, worth_of_few
from research.suites.validation_scenes import PROCEDURAL, procedural_scene

SCALES = {"fox": 4.0, "bonsai": 4.0, "brighton": 4.0, "alexander": 4.0}
SCALES |= {"indoor": 1.0, "outdoor": 1.0, "object": 1.0}
"""Scenes by name, and by what their photos' sides were divided in training."""
LEVELS, VIEWS = 4, 16
"""Import of a scene, and the true cameras in whose images it is measured."""
COLUMNS = "scene,splats,up_off,seen,level,found_db,true_db,back_db,seconds"
SEEN = 0.1
"""Share of the pixels a splat fills in its best true image from which on a found one sees it.
"""


def stepped_back(cameras: Sequence[Camera], factor: float = 1.25) -> list[Camera]:
    """Cameras that look the same way from farther off the point that all look at."""
    places = positions_of(cameras)
    target = nearest_to_axes(places, np.stack([camera.forward for camera in cameras]))
    out: list[Camera] = []
    for camera, place in zip(cameras, places, strict=True):
        w2c = camera.w2c.copy()
        w2c[:3, 3] = -w2c[:3, :3] @ (target + factor * (place - target))
        out.append(replace(camera, w2c=w2c))
    return out


def best_pixels(model: SplatModel, cameras: Sequence[Camera], renderer: Renderer) -> torch.Tensor:
    """Pixels that each splat fills in the picture that shows most of it, [G]."""
    best = torch.zeros(len(model))
    for camera in cameras:
        decoded = model.decode_level(-1, camera)
        pixels = blend_weights(renderer, decoded.gaussians, camera) / camera.fx / camera.fy
        best.scatter_reduce_(0, decoded.slots, pixels.detach(), "amax")
    return best


def decibels(
    file: SplatFile, cameras: Sequence[Camera], views: Sequence[Camera], renderer: Renderer
) -> list[float]:
    """PSNR of each level of an import that ranks from some cameras, in pictures of others."""
    finest = file.levels[-1]
    truth = splat_model(file)
    quiet = lambda what, done, total: None  # noqa: E731
    worth = worth_of(truth, shown(finest), cameras, renderer, quiet)
    counts, _ = counts_of(file, LEVELS, fitted=False)
    worth = worth_of_few(truth, worth, counts[0], cameras, renderer, quiet)
    made = splat_levels(finest, worth, counts, {}, ROUNDING, file.environment)
    made = with_gains(made, cameras[:: -(-len(cameras) // GAIN_VIEWS)], truth, renderer, quiet)
    model = decoder_of(made)
    assert isinstance(model, SplatModel)
    pictures = [painted(truth, 0, camera, renderer) for camera in views]
    return [figure["psnr_full"] for figure in measured(model, pictures, views, renderer, quiet)]


@one_torch_thread()
def figures(name: str, ply: Path, scene: Scene) -> dict[str, object]:
    """All figures of a scene."""
    renderer = CpuRenderer(1)
    file = replace(read_splats(ply), up=DOWN, up_said=False)
    cameras = [scene.camera(view, SCALES[name]) for view in range(len(scene.views))]
    start = time.process_time()
    found = for_splats(file, renderer=renderer)
    seconds = time.process_time() - start
    up = up_of_cameras(cameras)
    model = SplatModel(file.levels[-1])
    mass = sum_of_pixels(model, cameras, renderer)
    there = best_pixels(model, found.cameras, renderer)
    seen = there >= SEEN * best_pixels(model, cameras, renderer)
    views = cameras[:: -(-len(cameras) // VIEWS)]
    own, _ = ranking_and_quality(found)
    true, _ = ranking_and_quality(Viewpoints(tuple(cameras), found.up, given=True))
    return {
        "scene": name,
        "splats": len(model),
        "up_off": float(np.degrees(np.arccos(np.clip(up @ np.array(found.up), -1, 1)))),
        "seen": float(mass[seen].sum() / mass.sum()),
        "found_db": decibels(file, own, views, renderer),
        "true_db": decibels(file, true, views, renderer),
        "back_db": decibels(file, stepped_back(true), views, renderer),
        "camera_seconds": seconds,
        "lines": found.lines,
    }


def sum_of_pixels(model: SplatModel, cameras: Sequence[Camera], renderer: Renderer) -> torch.Tensor:
    """Pixels that each splat fills in all pictures, [G]."""
    total = torch.zeros(len(model))
    for camera in cameras:
        decoded = model.decode_level(-1, camera)
        weights = blend_weights(renderer, decoded.gaussians, camera)
        total.index_add_(0, decoded.slots, weights.detach())
    return total


def folder_of(name: str, data: Path, cache: Path) -> Path:
    """Photos of a scene; procedural ones are made."""
    return procedural_scene(name, cache) if name in PROCEDURAL else data / name


def csv_lines(found: Mapping[str, object]) -> list[str]:
    """Lines of the CSV, one a level, see `COLUMNS`."""
    own, true, back = (cast(list[float], found[f"{k}_db"]) for k in ("found", "true", "back"))
    head = f"{found['scene']},{found['splats']},{found['up_off']:.2f},{found['seen']:.4f}"
    tail = f"{found['camera_seconds']:.1f}"
    return [
        f"{head},{level},{a:.2f},{b:.2f},{c:.2f},{tail}"
        for level, (a, b, c) in enumerate(zip(own, true, back, strict=True))
    ]


def row(found: dict[str, object]) -> str:
    """A line of the table."""
    own, true, back = (cast(list[float], found[f"{k}_db"]) for k in ("found", "true", "back"))
    levels = " | ".join(
        f"{a:.2f} ({a - b:+.2f}; {c - b:+.2f})" for a, b, c in zip(own, true, back, strict=True)
    )
    up, seen, seconds = (float(str(found[k])) for k in ("up_off", "seen", "camera_seconds"))
    first = f"| *{found['scene']}* | {up:.1f}° | {100 * seen:.1f} %"
    return f"{first} | {levels} | {seconds:.1f} s |"


def main() -> None:
    """Measure what the command line names; JSON lines, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder for NAME/input.ply of each scene")
    parser.add_argument("scenes", nargs="*", help=f"of {', '.join(SCALES)}; all if none is named")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--cache", type=Path, default=Path("runs/procedural"))
    parser.add_argument("--steps", type=int, default=2000, help="of 3DGS")
    parser.add_argument("--csv", type=Path, help="file for one line a level")
    options = parser.parse_args()
    rows: list[str] = []
    lines = [COLUMNS]
    for name in options.scenes or SCALES:
        ply = options.out / name / "input.ply"
        try:
            folder = folder_of(name, options.data, options.cache)
            ply.parent.mkdir(parents=True, exist_ok=True)
            scene = load_scene(folder)
            trained(scene, SCALES[name], options.steps, ply)
            found = figures(name, ply, scene)
        except InputError as error:
            print(f"skipped {name}: {error}")
            continue
        print(json.dumps(found), flush=True)
        rows.append(row(found))
        lines += csv_lines(found)
        if options.csv is not None:
            options.csv.write_text("\n".join(lines) + "\n")
    levels = " | ".join(f"L{level}" for level in range(LEVELS))
    print("Decibels (less those of true cameras; the same of these a quarter farther away)")
    print(f"| scene | up off by | seen | {levels} | processor |")
    print("| --- " * (LEVELS + 4) + "|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
