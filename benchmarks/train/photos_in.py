"""Photos in: poses estimated here against given ones, masks, and exposure that differs.

`python -m benchmarks.train.photos_in` fills docs/results/photos.csv, a row for
each training; what is trained already is not again, so parts may be run one after the other.
"""

import argparse
import csv
import dataclasses
import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import gsynopsis as gs
from gsynopsis.evaluation.phrases import duration
from gsynopsis.pipeline.poses import estimate_poses
from gsynopsis.pipeline.progress import Display
from gsynopsis.scene.colmap_binary import read_binary, write_binary

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("GSYNOPSIS_DATA", ROOT.parent / "shared" / "data"))
RESULT = ROOT / "docs" / "results" / "photos.csv"
SCENES = ("brighton", "fox", "alexander")
COLUMNS = (
    *("part", "scene", "variant", "photos", "registered", "sfm_minutes", "error_px"),
    *("steps", "scale", "width", "height", "held_out", "psnr", "psnr_masked", "psnr_exposed"),
    *("mib", "train_minutes", "seed", "cpu", "threads", "commit"),
)
Row = dict[str, object]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("runs/photos_in"), help="for all runs")
    parser.add_argument("--part", choices=[*PARTS, "table"], nargs="+", default=list(PARTS))
    parser.add_argument("--scenes", nargs="+", default=SCENES, help="of the part `poses`")
    parser.add_argument("--steps", type=int, default=600, help="of the full training")
    parser.add_argument("--scale", type=float, default=4.0, help="photos are divided by this")
    given = parser.parse_args()
    for part in given.part:
        if part != "table":
            PARTS[part](given)
    write_table(given.work)


def poses(given: argparse.Namespace) -> None:
    """Each scene with the poses that it came with, and of its photos alone."""
    for scene in given.scenes:
        own = given.work / "scenes" / scene
        with Display() as display:
            report = estimate_poses(DATA / scene / "images", own, observer=display)
        facts = {
            "photos": report.photos,
            "registered": len(report.found.registered),
            "sfm_minutes": round(sum(report.seconds.values()) / 60, 2),
            "error_px": round(report.found.error, 3),
        }
        same = subset(DATA / scene, own.with_name(f"{scene}_given"), report.found.registered)
        train(given, ("poses", scene, "given"), same, {"photos": report.photos})
        train(given, ("poses", scene, "own"), own, facts)


def train(
    given: argparse.Namespace, key: tuple[str, str, str], folder: Path, facts: Row, **asked: object
) -> None:
    """One training, and its row beside it."""
    out = given.work / "_".join(key)
    if (out / "row.json").is_file():
        return
    print(f"{' '.join(key)}:", flush=True)
    scene = gs.load_scene(folder)
    settings = {"train.steps": given.steps, "scale": given.scale, **asked}
    run = gs.train(scene, gs.resolve("fast", scene, settings), out)
    report = json.loads((out / "metrics.json").read_text("utf-8"))
    finest, machine = report["levels"][-1], report["machine"]
    row = dict(zip(("part", "scene", "variant"), key, strict=True)) | facts
    row |= {
        "steps": run.steps,
        "scale": given.scale,
        "width": report["size"][0],
        "height": report["size"][1],
        "held_out": report["held_out_views"],
        "psnr": round(finest["psnr_full"], 3),
        "psnr_masked": finest.get("psnr_masked"),
        "psnr_exposed": finest.get("psnr_exposed"),
        "mib": round(run.file.stat().st_size / 2**20, 4),
        "train_minutes": round((run.train_seconds or 0) / 60, 2),
        "seed": run.seed,
        "cpu": machine["cpu"],
        "threads": machine["threads"],
        "commit": report["commit"],
    }
    (out / "row.json").write_text(json.dumps(row, indent=1) + "\n", "utf-8")
    print(f"  {row['psnr']} dB, {row['mib']} MiB, {duration(run.train_seconds or 0)}", flush=True)


def subset(source: Path, out: Path, names: Sequence[str]) -> Path:
    """The given scene with these photos alone, so that both hold out the same ones."""
    shutil.rmtree(out, ignore_errors=True)
    model = read_binary(source / "sparse" / "0")
    kept = tuple(image for image in model.images if image.name in set(names))
    write_binary(out / "sparse" / "0", dataclasses.replace(model, images=kept))
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


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {"poses": poses}

if __name__ == "__main__":
    main()
