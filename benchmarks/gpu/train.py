"""Trains a scene in this process; notes time, peak memory and machine.

python -m benchmarks.gpu.train --scene SCENE --results build/gpu/results
"""

import json
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

import benchmarks.bench as bench
from benchmarks.bench import CPU, RUNS, metrics_of, short_commit
from gsynopsis.config import PresetName
from gsynopsis.errors import GsynopsisError
from gsynopsis.render.choose import make_renderer
from gsynopsis.selftest.check_device import machine_record
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.loop import peak_memory
from gsynopsis.training.observer import Silent

KEPT = ("metrics.json", "metrics.csv", "report.html", "contact.png", "scene.gsyn")
LARGEST = 16 * 2**20
"""Files above this many bytes are not kept."""


@dataclass(frozen=True)
class Settings:
    """Options of the training.

    Attributes:
        results: Folder for train.json and the run's small files.
        scene: Folder of a scene; a procedural room at its full size if not given.
        run: Folder of the run; an earlier one is replaced.
        backend: Rasteriser.
        preset: Preset of the settings.
        scale: Divide the photos' width and height by this.
        steps: Steps of the full training; the preset's if not given.
        commit: Commit of this tree, if it has no history.
    """

    results: Path
    scene: Path | None = None
    run: Path = RUNS / "gpu"
    backend: Literal["cuda", "cpu"] = "cuda"
    preset: PresetName = "standard"
    scale: float = 4.0
    steps: int | None = None
    commit: str = ""


class Told(Silent):
    """Prints a training's messages: its plan, its checkpoints, its file."""

    def on_message(self, text: str) -> None:
        """As it comes."""
        print(text, flush=True)


def main(settings: Settings) -> int:
    """Train, evaluate, write; the exit code."""
    try:
        device = make_renderer(settings.backend).device
    except GsynopsisError as error:
        print(f"gpu train: not run: {error}", file=sys.stderr)
        return 2
    shutil.rmtree(settings.run, ignore_errors=True)
    scene, scale = settings.scene, settings.scale
    if scene is None:
        scene, scale = make_scene("room", settings.run / "room"), 1.0
    out = settings.run / "run"
    asked: dict[str, Any] = {"scale": scale}
    if settings.steps is not None:
        asked["train.steps"] = settings.steps
    start, code = time.perf_counter(), 0
    try:
        bench.train(scene, out, asked, settings.preset, Told(), renderer=settings.backend)
    except GsynopsisError as error:
        print(f"gpu train: {error}", file=sys.stderr)
        code = error.exit_code
    seconds = time.perf_counter() - start
    settings.results.mkdir(parents=True, exist_ok=True)
    record = {
        "preset": settings.preset,
        "asked": asked,
        "exit_code": code,
        "seconds": round(seconds, 3),
        "seconds_of_training": _read(out / "run.json").get("train_seconds"),
        "peak_bytes_of_the_process": peak_memory(CPU),
        "peak_bytes_of_the_gpu": peak_memory(device) if device.type == "cuda" else None,
        "levels": [_quality(level) for level in metrics_of(out).get("levels", [])],
        "machine": machine_record(device) | {"commit": settings.commit or short_commit()},
    }
    (settings.results / "train.json").write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    keep(out, settings.results)
    print(f"trained and evaluated in {seconds:.0f} s, exit code {code}")
    return code


def keep(run: Path, results: Path) -> None:
    """Copy the files that a reader of the results wants to see."""
    for name in KEPT:
        source = run / name
        if source.is_file() and source.stat().st_size <= LARGEST:
            shutil.copyfile(source, results / name)
        elif source.is_file():
            print(f"{source} is over {LARGEST >> 20} MiB and stays there")


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}


def _quality(level: dict[str, Any]) -> dict[str, Any]:
    return {k: level[k] for k in ("level", "anchors", "psnr_full", "ssim_full") if k in level}


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings, description=__doc__)))
