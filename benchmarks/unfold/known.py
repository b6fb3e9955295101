"""Finished splats of scenes whose photos are known: what is left of them on real held-out photos.

    python -m benchmarks.unfold.known OUT fox brighton --data ../shared/data [--steps 3000]

Of each scene 3DGS is trained on the training photos (research/baselines/gaussians.py, harmonics of
degree 3) and written as a PLY, the input of all roads: `import` and `unfold` from cameras that
they find, from those of all photos or of the training ones (`--cameras`), and beside the training
photos (`--scene`); thinned splats (`import --steps 0`); files of other formats. Every figure is
PSNR on the same held-out photos, which nothing was trained on and nothing chosen by. What is done
is not done again. Writes known.csv into OUT. Scenes that are not there are skipped.
"""

import argparse
import csv
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch

from benchmarks.unfold.run import OTHERS, against, reread
from gsynopsis.config import resolve_settings
from gsynopsis.container.info import describe
from gsynopsis.container.reader import read_gsyn
from gsynopsis.errors import InputError
from gsynopsis.evaluation.environment import this_build, this_machine
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.training.growth import growth_limit
from research.baselines.gaussians import Training, from_points, train_gaussians

SCALES = {"fox": 2.0, "bonsai": 2.0, "brighton": 2.0}
"""Scenes by name, and what their photos' sides are divided by."""
RATES = 2.0
"""Factor on 3DGS's learning rates, as suites/rivals.toml has it for short trainings."""
ROADS = {
    "import": (),
    "import --cameras": ("--cameras", "{scene}"),
    "import --steps 0": ("--steps", "0"),
    "unfold": (),
    "unfold --cameras": ("--cameras", "{scene}"),
    "unfold --cameras, training": ("--cameras", "{training}"),
    "unfold --scene": ("--scene", "{scene}"),
}
"""Commands on the PLY, with the scene's folder and a file of the cameras of training photos."""
COLUMNS = "scene,width,height,photos,splats,method,level,bytes,db,seconds,commit,machine"


def trained(scene: Scene, factor: float, steps: int, path: Path) -> float:
    """Train 3DGS and write it, if it is not there; seconds it took, 0 if it was."""
    if path.exists():
        return 0.0
    asked = {"scale": factor, "train.exposure": "off"}
    config = resolve_settings("standard", len(scene.train), asked).config
    training = Training(
        steps, factor, grow=True, rates=RATES, most=growth_limit(scene, config), subpixels=4
    )

    def tick(done: int, total: int) -> None:
        if done % 100 == 0:
            print(f"{path.parent.name}: 3DGS {done}/{total}", flush=True)

    started = time.monotonic()
    found = train_gaussians(from_points(scene), scene, CpuRenderer(1), training, tick)
    path.write_bytes(ply_bytes(found))
    return time.monotonic() - started


def cameras_of(scene: Scene, out: Path) -> Path:
    """A cameras.json, as 3DGS writes it, of the training photos."""
    found: list[dict[str, object]] = []
    for view in scene.train:
        camera, name = scene.camera(view), scene.views[view].name
        turn, place = camera.w2c[:3, :3].T.tolist(), camera.position.tolist()
        lens = {"width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy}
        found.append({"id": view, "img_name": name, "position": place, "rotation": turn, **lens})
    path = out / "training" / "cameras.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(found))
    return path


def measured(
    scene: Scene, out: Path, factor: float, steps: int, roads: Sequence[str]
) -> Iterator[tuple[int, str, int, int, float, float]]:
    """Rows of one scene: splats of the input, method, level, bytes, dB, seconds."""
    ply, training = out / "input.ply", cameras_of(scene, out)
    seconds = trained(scene, factor, steps, ply)
    given = read_splats(ply).levels[-1]
    splats, whole = len(given), against(SplatModel(given), 0, scene, factor)
    yield splats, "3DGS (the input)", 0, ply.stat().st_size, whole, seconds
    for kind, encoded in OTHERS.items():
        started, made = time.monotonic(), encoded(given)
        took = time.monotonic() - started
        db = against(reread(kind, made, out), 0, scene, factor)
        yield splats, kind.split(".")[0], 0, len(made), db, took
    for name in roads:
        words = ROADS[name]
        command, place = name.split()[0], out / name.replace(" ", "")
        file = place.with_suffix(".gsyn") if command == "import" else place / "scene.gsyn"
        asked = [word.format(scene=scene.root, training=training) for word in words]
        target = file if command == "import" else place
        started = time.monotonic()
        if not file.exists():
            call = [command, str(ply), "--out", str(target), *asked, "--quiet"]
            subprocess.run([sys.executable, "-m", "gsynopsis", *call], check=True)
        took, model = time.monotonic() - started, decoder_of(read_gsyn(file))
        for level in describe(file).levels:
            db = against(model, level.level, scene, factor)
            yield splats, name, level.level, level.bytes, db, took


def main() -> None:
    """Measure the scenes that are named and there."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="*", help=f"of {', '.join(SCALES)}; all if none is named")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--steps", type=int, default=3000, help="of 3DGS")
    parser.add_argument("--roads", nargs="*", choices=ROADS, default=list(ROADS))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    machine, commit = this_machine(torch.device("cpu")).cpu, this_build().commit
    rows: list[tuple[object, ...]] = []
    for name in args.scenes or SCALES:
        place, factor = args.out / name, SCALES[name]
        place.mkdir(exist_ok=True)
        try:
            scene = load_scene(args.data / name)
        except InputError as error:
            print(f"skipped {name}: {error}")
            continue
        camera = scene.camera(scene.test[0], factor)
        for *figures, db, seconds in measured(scene, place, factor, args.steps, args.roads):
            head = (name, camera.width, camera.height, len(scene.test))
            rows.append((*head, *figures, f"{db:.2f}", f"{seconds:.0f}", commit, machine))
            print(*rows[-1], flush=True)
            with (args.out / "known.csv").open("w", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(COLUMNS.split(","))
                writer.writerows(rows)


if __name__ == "__main__":
    main()
