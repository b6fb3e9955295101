"""One cell of a suite, run in its own process: train, evaluate, rows of the table."""

import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from gsynopsis import __version__
from gsynopsis.config import Config
from gsynopsis.errors import GsynopsisError, SettingError
from gsynopsis.files import publish
from gsynopsis.runs.folder import make_folder
from gsynopsis.scene.scene import Scene, SceneOptions
from research.suites.suite import PROCEDURAL_PREFIX, Baseline, Cell
from research.suites.validation_scenes import procedural_scene

if TYPE_CHECKING:
    from research.baselines.checkpoint_cache import TrainingCache
    from research.baselines.methods import Task

CELL_FILE, ROWS_FILE = "cell.json", "rows.json"
"""Files of a cell's folder: the settings and version it began with, and the rows once finished."""
GAUSSIANS_FOLDER = "grown"
"""Folder beside the cells', with what several baselines begin with."""
Row = dict[str, Any]
FIGURES = (
    *("psnr_full", "psnr_own", "psnr_train", "ssim_full", "ssim_own", "flip_full", "flip_own"),
    *("lpips_full", "lpips_own"),
)
UNCODED_FILE = "uncoded.json"
"""File of a baseline's cell with the PSNR of each level before any value was rounded, dB."""
UNCODED_COLUMN = "psnr_uncoded"
SIZES = ("bytes_raw", "bytes_deflate", "bytes_compact", "delta_compact", "bytes_paper")
COLUMNS = (
    *("scene", "method", "seed", "level", "anchors", "slots", *SIZES, *FIGURES),
    UNCODED_COLUMN,
    *("total_ms", "width", "height", "test_photos", "split", "scale"),
    *("seconds", "cpu_seconds", "peak_mib"),
    *("version", "commit", "machine"),
)
"""Columns of the CSV.

Of scenes with masks `psnr_full` and `psnr_train` count inside of them, where methods are trained.
`psnr_uncoded` is `psnr_full` of a baseline before any value was rounded, where it was measured.
`total_ms` is the median of a frame, `seconds` the wall time of training, `cpu_seconds` the
processor time of all threads of the cell's last process, evaluation included. Both count Gaussians
read from another cell as if this one had trained them; a full model read from another cell is in
`seconds` alone. `peak_mib` is the most memory of that process.
"""


def finished_rows(folder: Path) -> list[Row] | None:
    """The rows of a finished cell; None if it is not finished.

    Raises:
        SettingError: the file is damaged.
    """
    path = folder / ROWS_FILE
    if not path.is_file():
        return None
    try:
        return msgspec.json.decode(path.read_bytes(), type=list[dict[str, Any]])
    except msgspec.DecodeError as error:
        raise SettingError(path, found=error, expected="rows; remove it to run the cell") from error


def check_versions(cell: Cell, cells: Path) -> None:
    """No half-finished cell of this name is of another version.

    Raises:
        SettingError: one is.
    """
    for begun in sorted(cells.glob(f"{cell.stem}-????????/{CELL_FILE}")):
        if (begun.parent / ROWS_FILE).is_file():
            continue
        version = json.loads(begun.read_text("utf-8")).get("version")
        if version != __version__:
            raise SettingError(
                begun.parent,
                found=f"a half-finished cell of version {version}",
                expected=f"{__version__}",
                advice="remove the folder, or finish it with that version",
            )


def run_cell(cell: Cell, folder: Path, cache: Path) -> list[Row] | str:
    """Train and measure a cell, or go on where it was stopped; its rows, or why there are none.

    Args:
        cell: Which.
        folder: Its own, for checkpoints and results.
        cache: Where procedural scenes are.
    """
    try:
        make_folder(folder)
        publish(
            folder / CELL_FILE, json.dumps({"version": __version__, "settings": dict(cell.asked)})
        )
        before = _train_cell(cell, folder, cache)
        metrics = json.loads((folder / "metrics.json").read_text("utf-8"))
        rows = rows_of(cell, metrics, before)
        uncoded = folder / UNCODED_FILE
        if uncoded.is_file():
            for row, psnr in zip(rows, json.loads(uncoded.read_text("utf-8")), strict=True):
                row[UNCODED_COLUMN] = round(psnr, 4)
        publish(folder / ROWS_FILE, json.dumps(rows, indent=1))
    except (GsynopsisError, OSError) as error:
        return f"{type(error).__name__}: {error}"
    return rows


def _train_cell(cell: Cell, folder: Path, cache: Path) -> float:
    """Leave a cell's file and measurements in its folder.

    Returns:
        CPU seconds that other processes spent for it.
    """
    from gsynopsis.evaluation.lpips import load_lpips
    from gsynopsis.evaluation.report_files import write_report
    from gsynopsis.jobs.evaluate import Measures, evaluate
    from gsynopsis.jobs.resolve import resolve
    from gsynopsis.jobs.train import train
    from gsynopsis.jobs.unfold import unfold
    from gsynopsis.render.choose import make_renderer
    from gsynopsis.scene.load import load_scene
    from gsynopsis.training.observer import Silent
    from research.baselines.checkpoint_cache import TrainingCache
    from research.baselines.train import run_baseline

    lpips = load_lpips(Path(cell.lpips), make_renderer("auto").device) if cell.lpips else None
    if cell.unfolds:
        # Of the recorded run the scene and its scale are known, see `scale_of`.
        asked = {name: value for name, value in cell.asked.items() if name != "scale"}
        unfold(folder.parent / cell.unfolds.name, folder, asked, Silent(), photo_pixels=0)
    else:
        reading = SceneOptions(cell.images)
        scene = load_scene(scene_folder(cell, cache), cell.asked["split"], reading)
        recipe = resolve(cell.preset, scene, {**cell.asked, "scale": scale_of(cell, scene)})
        if cell.baseline:
            kept = TrainingCache(folder.parent.parent / GAUSSIANS_FOLDER / cell.grown)
            task = task_of(cell.baseline, scene, recipe.config, kept)
            run_baseline(cell.baseline.name, task, folder, lpips)
            return kept.cpu_seconds
        train(scene, recipe, folder, Silent(), photo_pixels=0)
    if lpips:
        measures = Measures(photo_pixels=0, lpips=lpips)
        write_report(evaluate(folder, measures=measures, tick=_untold), folder)
    return 0.0


def _untold(done: int, count: int) -> None:
    """Progress of an evaluation, of which nobody is told."""


def task_of(
    baseline: Baseline, scene: Scene, config: Config, kept: "TrainingCache | None" = None
) -> "Task":
    """Inputs of a baseline: as many images as our training has, as large, of as many Gaussians.

    The bound on what grows, the photos' samplings and the ordered loss of rounding are ours, too.
    """
    from gsynopsis.render.choose import make_renderer
    from gsynopsis.training.growth import growth_limit
    from gsynopsis.training.regularize.jitter import subpixels_of
    from research.baselines.methods import Task

    levels, growth = config.levels, config.train.growth
    if baseline.per_pixel:
        growth = replace(growth, per_pixel=baseline.per_pixel)
        config = replace(config, train=replace(config.train, growth=growth))
    if levels.mode == "joint":
        images = round(levels.steps * min(levels.levels_per_step, levels.count))
    else:
        images = levels.steps * (levels.count - 1)
    return Task(
        scene,
        make_renderer("auto"),
        config.scale,
        config.train.steps,
        images,
        seed=config.train.seed,
        rates=baseline.rates,
        reset=baseline.reset,
        degree=baseline.degree,
        most=growth_limit(scene, config),
        subpixels=subpixels_of(config),
        coding_loss=levels.coding_loss if levels.mode == "joint" else 0.0,
        kept=kept,
    )


def scale_of(cell: Cell, scene: Scene) -> float:
    """Divisor of the photos: the suite's scale, or more where photos are too wide."""
    widest = max(view.camera.width for view in scene.views)
    return max(cell.asked["scale"], widest / cell.max_width if cell.max_width else 1.0)


def scene_folder(cell: Cell, cache: Path) -> Path:
    """Folder of a cell's scene; a procedural scene is made if it is missing."""
    known = cell.path.removeprefix(PROCEDURAL_PREFIX)
    return Path(cell.path) if known == cell.path else procedural_scene(known, cache)


def rows_of(cell: Cell, metrics: Row, before: float = 0) -> list[Row]:
    """One row a level of what an evaluation found.

    Args:
        cell: Which.
        metrics: What `evaluate` wrote.
        before: CPU seconds that other processes spent for this cell.
    """
    whole = {"scene": cell.scene, "method": cell.method, "seed": cell.seed}
    after = {
        "test_photos": metrics["held_out_views"],
        "split": metrics["split"],
        "scale": metrics["scale"],
        "seconds": metrics["train_seconds"],
        "cpu_seconds": before + time.process_time(),
        "peak_mib": peak_mib(),
        "version": __version__,
        "commit": (metrics.get("commit") or "unknown")[:12],
        "machine": f"{metrics['machine']['cpu']}, {metrics['machine']['cores']} cores",
    }
    rows: list[Row] = []
    for level in metrics["levels"]:
        own = {name: level[name] for name in ("level", "anchors", "slots", *SIZES)}
        own |= {name: level.get(name) for name in (*FIGURES, "total_ms")}
        if level.get("psnr_masked") is not None:
            inside = {"psnr_full": "psnr_masked", "psnr_train": "psnr_train_masked"}
            own |= {name: level[masked] for name, masked in inside.items()}
        own |= {"width": level["width_full"], "height": level["height_full"]}
        row = {**whole, **own, **after}
        rows.append({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()})
    return rows


def peak_mib() -> float:
    """The most memory that this process has had, MiB."""
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
