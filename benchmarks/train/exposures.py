"""Check of `train.exposure auto`: real scenes, and changes that look like exposure but are not.

    python -m benchmarks.train.exposures OUT --scenes fox brighton

Each scene is taken as it is and with made-up changes of its photos. `gains` is exposure that
differs (every photo by itself, ±30 % and a white balance of ±10 %), which has to be found;
`vignette`, `highlights` and `object` are not, and nothing may be lost on them. OUT/exposures.csv
has the evidence of each, and the fork's decision if it is needed.
"""

import argparse
import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.train.photos_in import DATA
from gsynopsis.jobs.decide_exposure import decide_exposure
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.resolve import resolve
from gsynopsis.jobs.train_run import make_context
from gsynopsis.scene.exposure import exposure_evidence
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.training.observer import Silent

Pixels = NDArray[np.float64]
Change = Callable[[Scene, int, Pixels, np.random.Generator], Pixels]


def gains(scene: Scene, view: int, pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """The pixels times a random gain for each training photo; held-out ones stay as they are."""
    own = rng.uniform(0.7, 1.3) * rng.uniform(0.9, 1.1, 3)
    return pixels if view in scene.test else pixels * own


def vignette(scene: Scene, view: int, pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """Corners at half of the light, as a wide open lens has."""
    high, wide = pixels.shape[:2]
    y, x = np.mgrid[-1 : 1 : high * 1j, -1 : 1 : wide * 1j]
    return pixels * (1 - 0.25 * (x**2 + y**2))[:, :, None]


def highlights(scene: Scene, view: int, pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """White lights at thirty points, each seen from one side only."""
    fixed = np.random.default_rng(7)
    camera, (high, wide) = scene.views[view].camera, pixels.shape[:2]
    points = scene.points[fixed.integers(0, len(scene.points), 30)]
    sides = fixed.normal(size=(30, 3))
    toward = camera.position - points
    facing = (
        (toward * sides).sum(1) / np.linalg.norm(toward, axis=1) / np.linalg.norm(sides, axis=1)
    )
    framed = camera.framed(points)
    y, x = np.mgrid[:high, :wide]
    for column, row, shine in zip(
        framed.columns, framed.rows, facing[framed.which].clip(0) ** 4, strict=True
    ):
        square = (x - column) ** 2 + (y - row) ** 2
        pixels = pixels + 255 * shine * np.exp(-square / (2 * (wide / 16) ** 2))[:, :, None]
    return pixels


def colored_object(scene: Scene, view: int, pixels: Pixels, rng: np.random.Generator) -> Pixels:
    """A red thing before the lower half of every other photo."""
    if view % 2:
        high = len(pixels)
        pixels[high // 2 :] = pixels[high // 2 :] * 0.2 + np.array([150.0, 20.0, 20.0])
    return pixels


CHANGES: dict[str, Change | None] = {
    "as it is": None,
    "gains": gains,
    "vignette": vignette,
    "highlights": highlights,
    "object": colored_object,
}


def changed_scene(source: Path, out: Path, change: Change) -> Path:
    """A copy of a scene whose photos are changed, as PNG of the same names."""
    if out.exists():
        return out
    scene, rng = load_scene(source), np.random.default_rng(3)
    draft = out.with_name(out.name + ".part")
    shutil.rmtree(draft, ignore_errors=True)
    shutil.copytree(source, draft, ignore=shutil.ignore_patterns("SOURCE.md"))
    for number, view in enumerate(scene.views):
        path = draft / view.path.relative_to(source)
        with Image.open(path) as photo:
            pixels = np.asarray(photo.convert("RGB"), np.float64)
        after = change(scene, number, pixels, rng)
        image = Image.fromarray(np.rint(after.clip(0, 255)).astype(np.uint8))
        image.save(path, quality=95, subsampling=0)
    return draft.rename(out)


def main() -> None:
    """Decide for each scene and change; write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", nargs="+", default=["fox", "brighton", "alexander", "bonsai"])
    parser.add_argument("--changes", nargs="+", default=list(CHANGES), choices=list(CHANGES))
    parser.add_argument("--scale", type=float, default=4.0)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = list[dict[str, object]]()
    for name in given.scenes:
        for label in given.changes:
            change, source = CHANGES[label], DATA / name
            folder = (
                source
                if change is None
                else changed_scene(source, given.out / f"{name}_{label}", change)
            )
            rows.append({"scene": name, "photos": label, **decided(folder, given.scale)})
            print(rows[-1], flush=True)
            with (given.out / "exposures.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, list(rows[0]))
                writer.writeheader()
                writer.writerows(rows)


def decided(folder: Path, scale: float) -> dict[str, object]:
    """The evidence of a scene, the decision and its reason."""
    scene = load_scene(folder)
    evidence = exposure_evidence(scene)
    recipe = resolve("standard", scene, {"scale": scale})
    context = make_context(scene, recipe.config, RunOptions())
    value, reason = decide_exposure(context, Silent(), lambda: False)
    figures = {
        name: round(getattr(evidence, name), 3)
        for name in ("agreement", "explained", "spread", "unpredicted")
    }
    return {**figures, "auto": value, "reason": reason}


if __name__ == "__main__":
    main()
