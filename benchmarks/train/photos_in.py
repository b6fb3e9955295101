"""Photos in: poses estimated here against given ones, masks, and exposure that differs.

`python -m benchmarks.train.photos_in` fills docs/results/photos.csv, a row for
each training; what is trained already is not again, so parts may be run one after the other.
"""

import argparse
import csv
import json
import shutil
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image

import gsynopsis as gs
from benchmarks.bench import DATA, ROOT
from gsynopsis.evaluation.formatting import duration
from gsynopsis.evaluation.report import Report
from gsynopsis.jobs.estimate_poses import REPORT_FILE, estimate_poses
from gsynopsis.jobs.evaluate import Measures
from gsynopsis.monitor.display import Display
from gsynopsis.scene.colmap.binary import read_binary, write_binary
from gsynopsis.scene.colmap.distortion import Lens
from gsynopsis.scene.colmap.model import MODEL_NAMES
from gsynopsis.scene.masks import MaskUse
from gsynopsis.scene.scene import SceneOptions
from gsynopsis.scene.splits import Split

RESULT = ROOT / "docs" / "results" / "photos.csv"
BENT = (0.08, -0.01, 0.001, -0.001)
"""Parameters of the made-up lens: k1, k2, p1, p2 of OPENCV."""
SCENES = ("brighton", "fox", "alexander")
COLUMNS = (
    *("part", "scene", "variant", "seed", "photos", "registered", "sfm_minutes", "error_px"),
    *("steps", "scale", "split", "width", "height", "held_out"),
    *("psnr", "psnr_masked", "psnr_exposed", "exposure", "mib"),
    *("levels", "train_minutes", "cpu", "threads", "commit"),
)
Row = dict[str, object]


@dataclass(frozen=True)
class TrainingHistory:
    """One training and the figures taken from it.

    Attributes:
        key: Part, scene, variant.
        folder: The scene to train on.
        facts: Columns that are known before.
        masks: Use of masks in training.
        exposure: Setting of that name.
        seed: Seed of the training.
        split: Rule that chooses the held-out photos.
        judged: The scene whose held-out photos are compared; None: that of the training.
    """

    key: tuple[str, str, str]
    folder: Path
    facts: Row = field(default_factory=dict[str, object])
    masks: MaskUse = "loss"
    exposure: str = "auto"
    seed: int = 0
    split: Split = "every8"
    judged: Path | None = None

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return "_".join((*self.key, str(self.seed)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("runs/photos_in"), help="for all runs")
    parser.add_argument("--part", choices=[*PARTS, "table"], nargs="+", default=list(PARTS))
    parser.add_argument("--scenes", nargs="+", default=SCENES, help="of `poses` and `distorted`")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of poses and exposure")
    parser.add_argument("--steps", type=int, default=400, help="of the full training")
    parser.add_argument("--level-steps", type=int, default=200, help="of all levels together")
    parser.add_argument("--scale", type=float, default=4.0, help="photos are divided by this")
    given = parser.parse_args()
    for part in given.part:
        if part != "table":
            PARTS[part](given)
    write_table(given.work)


def poses(given: argparse.Namespace) -> None:
    """Each scene with the poses that it came with, and of its photos alone."""
    for scene in given.scenes:
        own, facts = estimated(given.work / "scenes" / scene, DATA / scene / "images")
        same = with_given_poses(given.work, scene)
        for seed in given.seeds:
            train(given, TrainingHistory(("poses", scene, "given"), same, seed=seed))
            train(given, TrainingHistory(("poses", scene, "estimated"), own, facts, seed=seed))


def estimated(out: Path, photos: Path) -> tuple[Path, Row]:
    """The scene of these photos alone, and the columns that tell of it; one that is there stays."""
    if not (out / REPORT_FILE).is_file():
        with Display() as display:
            estimate_poses(photos, out, observer=display)
    report = json.loads((out / REPORT_FILE).read_text("utf-8"))
    return out, {
        "photos": report["photos"],
        "registered": len(report["found"]["registered"]),
        "sfm_minutes": round(sum(report["seconds"].values()) / 60, 2),
        "error_px": round(report["found"]["error"], 3),
    }


def with_given_poses(work: Path, scene: str) -> Path:
    """The scene as it came, of those photos alone that its estimated twin has placed."""
    folder = work / "scenes" / f"{scene}_given"
    if not folder.exists():
        report = json.loads((work / "scenes" / scene / REPORT_FILE).read_text("utf-8"))
        subset(DATA / scene, folder, report["found"]["registered"])
    return folder


def distorted(given: argparse.Namespace) -> None:
    """Photos bent by an OPENCV lens, read with it."""
    for scene in given.scenes:
        folder = given.work / "scenes" / f"{scene}_bent"
        if not (folder / "sparse").exists():
            bend(with_given_poses(given.work, scene), folder)
        train(given, TrainingHistory(("distorted", scene, "given"), folder))


def masks(given: argparse.Namespace) -> None:
    """Alexander without its masks, with them in the loss, and with an empty background.

    Its photos differ in exposure, which hides what masks do in the plain figure: so also without
    learning it.
    """
    for asked, text in (("auto", ""), ("off", ", exposure off")):
        for use in ("off", "loss", "empty"):
            course = TrainingHistory(
                ("masks", "alexander", f"{use}{text}"), DATA / "alexander", masks=use
            )
            train(given, replace(course, exposure=asked))


def gains(given: argparse.Namespace) -> None:
    """Fox with made-up gains, exposure learnt and not, held against its photos as taken."""
    folder = given.work / "scenes" / "fox_gains"
    if not (folder / "sparse").exists():
        change_exposure(DATA / "fox", folder)
    for asked in ("on", "off"):
        course = TrainingHistory(("exposure", "fox", f"gains {asked}"), folder, exposure=asked)
        train(given, replace(course, judged=DATA / "fox"))


def original(given: argparse.Namespace) -> None:
    """Cost of learning exposure if photos do not differ: fox as it is."""
    for seed in given.seeds:
        for asked in ("off", "on"):
            key = ("exposure", "fox", f"original {asked}")
            train(given, TrainingHistory(key, DATA / "fox", exposure=asked, seed=seed))


def differing(given: argparse.Namespace) -> None:
    """Gain of exposure if `auto` learns it, on photos held out for validation."""
    for seed in given.seeds:
        for scene in ("brighton", "alexander"):
            for asked in ("off", "on"):
                course = TrainingHistory(
                    ("exposure", scene, f"validation {asked}"), DATA / scene, seed=seed
                )
                train(given, replace(course, exposure=asked, split="validation"))


def train(given: argparse.Namespace, course: TrainingHistory) -> None:
    """One training, and its row beside it."""
    out = given.work / course.name.replace(" ", "_")
    if (out / "row.json").is_file():
        return
    print(f"{' '.join(course.key)}, seed {course.seed}:", flush=True)
    scene = gs.load_scene(course.folder, course.split, SceneOptions(masks=course.masks))
    settings = {"train.steps": given.steps, "scale": given.scale, "train.seed": course.seed}
    settings |= {"levels.steps": given.level_steps, "train.exposure": course.exposure}
    recipe = gs.resolve("standard", scene, settings)
    run = gs.train(scene, recipe, out, evaluate=False)
    measures = Measures(frames=3, photo_pixels=0, exposure=True)
    judged = gs.load_scene(course.judged or course.folder, course.split)
    report = gs.evaluate(run, judged, split=course.split, measures=measures)
    finest, machine = report.levels[-1].quality, report.machine
    row: Row = dict(zip(("part", "scene", "variant"), course.key, strict=True))
    row |= {"photos": len(scene.views), "seed": course.seed, "split": course.split} | course.facts
    row |= {
        "steps": run.steps,
        "scale": given.scale,
        "width": report.width,
        "height": report.height,
        "held_out": len(scene.test),
        "psnr": round(finest.psnr_full, 3),
        "psnr_masked": finest.psnr_masked and round(finest.psnr_masked, 3),
        "psnr_exposed": finest.psnr_exposed and round(finest.psnr_exposed, 3),
        "exposure": recipe.config.train.exposure,
        "mib": round(run.file.stat().st_size / 2**20, 4),
        "levels": levels_text(report),
        "train_minutes": round((run.train_seconds or 0) / 60, 2),
        "cpu": machine.cpu,
        "threads": machine.threads,
        "commit": report.build.commit,
    }
    (out / "row.json").write_text(json.dumps(row, indent=1) + "\n", "utf-8")
    print(f"  {row['psnr']} dB, {row['mib']} MiB, {duration(run.train_seconds or 0)}", flush=True)


def levels_text(report: Report) -> str:
    """Figures of each level: MiB, PSNR plain, inside masks, with exposure solved; - if missing."""
    cells: list[str] = []
    for level in report.levels:
        q = level.quality
        figures = [q.psnr_full, q.psnr_masked, q.psnr_exposed]
        text = " ".join("-" if f is None else f"{f:.2f}" for f in figures)
        cells.append(f"{level.sizes.bytes_compact / 2**20:.4f} {text}")
    return "; ".join(cells)


def bend(source: Path, out: Path) -> None:
    """The scene as a camera with `BENT` would have taken it, and its model with that lens."""
    model = read_binary(source / "sparse" / "0")
    (number, c), *_ = model.cameras.items()
    grid = np.stack(np.meshgrid(np.arange(c.width) + 0.5, np.arange(c.height) + 0.5), axis=-1)
    lens = Lens(radial=BENT[:2], tangential=BENT[2:])
    bent = (grid.reshape(-1, 2).astype(np.float64) - (c.cx, c.cy)) / (c.fx, c.fy)
    plane, good = lens.undistorted(bent.astype(np.float64))
    assert good.all()
    places = (plane * (c.fx, c.fy) + (c.cx, c.cy)).reshape(grid.shape) - 0.5
    (out / "images").mkdir(parents=True, exist_ok=True)
    for image in model.images:
        with Image.open(source / "images" / image.name) as photo:
            pixels = bilinear(np.asarray(photo.convert("RGB")).astype(np.float32), places)
        Image.fromarray(pixels).save(out / "images" / image.name, quality=97, subsampling=0)
    folder = out / "sparse" / "0"
    write_binary(folder, model)
    data = bytearray((folder / "cameras.bin").read_bytes())
    assert len(model.cameras) == 1
    data[12:16] = MODEL_NAMES.index("OPENCV").to_bytes(4, "little")
    (folder / "cameras.bin").write_bytes(bytes(data) + struct.pack("<4d", *BENT))
    assert read_binary(folder).cameras[number].lens == lens


def bilinear(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """An image [H, W, 3] at places (x, y), pixel centres at whole numbers; its edge goes on."""
    height, width = image.shape[:2]
    x, y = places[..., 0].clip(0, width - 1.001), places[..., 1].clip(0, height - 1.001)
    i, j = x.astype(int), y.astype(int)
    u, v = (x - i)[..., None], (y - j)[..., None]
    top = image[j, i] * (1 - u) + image[j, i + 1] * u
    low = image[j + 1, i] * (1 - u) + image[j + 1, i + 1] * u
    return np.rint(top * (1 - v) + low * v).astype(np.uint8)


def change_exposure(source: Path, out: Path) -> None:
    """The scene with a gain of ±30 % and a white balance of ±10 % for each photo, seeded."""
    rng = np.random.default_rng(0)
    shutil.copytree(source / "sparse", out / "sparse")
    (out / "images").mkdir(parents=True, exist_ok=True)
    for path in sorted((source / "images").iterdir()):
        gain = rng.uniform(0.7, 1.3) * rng.uniform(0.9, 1.1, 3)
        with Image.open(path) as photo:
            pixels = np.asarray(photo.convert("RGB")) * gain
        changed = np.rint(pixels.clip(0, 255)).astype(np.uint8)
        Image.fromarray(changed).save(out / "images" / path.name, quality=97, subsampling=0)


def subset(source: Path, out: Path, names: Sequence[str]) -> Path:
    """The given scene with these photos alone, so that both hold out the same ones."""
    shutil.rmtree(out, ignore_errors=True)
    model = read_binary(source / "sparse" / "0")
    kept = tuple(image for image in model.images if image.name in set(names))
    write_binary(out / "sparse" / "0", replace(model, images=kept))
    (out / "images").symlink_to((source / "images").resolve())
    return out


def write_table(work: Path) -> None:
    """All rows that there are, in the order of parts and scenes."""
    rows = [json.loads(path.read_text("utf-8")) for path in sorted(work.glob("*/row.json"))]
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    print(f"wrote {RESULT.relative_to(ROOT)}: {len(rows)} rows")


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "poses": poses,
    "distorted": distorted,
    "masks": masks,
    "gains": gains,
    "original": original,
    "differing": differing,
}

if __name__ == "__main__":
    main()
