"""Learning rates of fine-tuning after baking, chosen on photos held back from the training photos.

    python -m benchmarks.interop.rates --runs runs/scenes

Every eighth training photo is kept for validation: level 3 is baked and fine-tuned without them, at
each factor on `training.finetune.RATES`, and measured on them. The held-out test photos are not
looked at. The level itself was trained on all training photos, which is the same for all factors.
Rows go into docs/results/baking_rates.csv.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

import benchmarks.bench as bench
from benchmarks.bench import RESULTS, stored_rows, write_rows
from benchmarks.interop.baking import TEXT
from gsynopsis.evaluation.load_model import open_levels
from gsynopsis.jobs.export import STEPS_DEFAULT, Photographed, mean_psnr
from gsynopsis.jobs.export_finetune import FineTuning, fine_tune
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.bake import Baking, bake
from gsynopsis.model.plain import PlainModel
from gsynopsis.runs.folder import find_run, scene_of
from gsynopsis.scene.load import load_scene

CSV = RESULTS / "baking_rates.csv"
FIRST, EVERY = 4, 8
"""Validation photos among the training photos: the first index, and the stride."""


@dataclass(frozen=True)
class Options:
    """Runs and factors to try.

    Attributes:
        runs: Folder that holds the runs.
        data: Folder that holds the scenes, if the runs' own paths do not.
        only: Names of runs.
        factors: Factors on all rates.
        level: Level of the files.
    """

    runs: Path = bench.RUNS / "scenes"
    data: Path | None = None
    only: tuple[str, ...] = ("fox-fast",)
    factors: tuple[float, ...] = (0.5, 1.0, 2.0)
    level: int = 3


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    rows = stored_rows(CSV, TEXT) if CSV.exists() else []
    for name in options.only:
        photos, file = held_back(options, name)
        opened = open_levels(file)
        if not isinstance(opened.decoder, AnchorModel):
            raise SystemExit(f"{file}: found splats, expected anchors")
        baked = bake(opened.decoder, options.level, photos.cameras(), opened.renderer, Baking())
        for factor in options.factors:
            model = PlainModel(baked, antialiased=False)
            tuning = FineTuning(STEPS_DEFAULT, photos.scene.extent, rate_scale=factor)
            fine_tune(model, len(photos.scene.train), photos.shot, opened.renderer, tuning)
            found = mean_psnr(opened, model, options.level, photos)
            rows = [r for r in rows if (r["run"], r["factor"]) != (name, factor)]
            rows.append(
                {
                    "run": name,
                    "factor": factor,
                    "validation_db": round(found, 4),
                    "photos": len(photos.scene.test),
                    "machine": bench.machine().cpu,
                    "commit": bench.short_commit(),
                }
            )
            print(rows[-1], flush=True)
            write_rows(CSV, rows)


def held_back(options: Options, name: str) -> tuple[Photographed, Path]:
    """Photos of a run whose `test` are training photos, and the run's file."""
    run = find_run(options.runs / name)
    given = options.data and options.data / name.split("-")[0]
    folder, scale, split = scene_of(run, given, None, None)
    scene = load_scene(folder, split)
    held = tuple(scene.train[FIRST::EVERY])
    kept = tuple(view for view in scene.train if view not in held)
    return Photographed(replace(scene, train=kept, test=held), scale), run.file


if __name__ == "__main__":
    main()
