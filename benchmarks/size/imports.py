"""Import a file of splats and measure it: seconds, bytes by level, decibels against the input.

`python -m benchmarks.size.imports FILE --rival SOG` prints one JSON object; the rival's bytes are
those of files, or of all files of folders. With `--sog` the same input is written as SOG too, whose
images are measured from the same views.
"""

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from gsynopsis.evaluation.metrics import Image8, psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.sog import sog_bytes
from gsynopsis.jobs.import_splats import ALL_VIEWS, VIEWS_SIDE, import_splats, ranking_and_quality
from gsynopsis.jobs.splat_views import known_cameras, splat_views
from gsynopsis.model.plain import PlainModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera


def bytes_of(path: Path) -> int:
    """Bytes of a file, or of a folder's files."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def sog_of(source: Path) -> dict[str, object]:
    """Bytes of the input as SOG, and decibels from the views of an import."""
    given = read_splats(source)
    finest = given.levels[-1]
    data = sog_bytes(finest)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.sog"
        path.write_bytes(data)
        found = read_splats(path).levels[-1]
    known = known_cameras(source, None)
    _, views = ranking_and_quality(splat_views(given, source, known, None, ALL_VIEWS, VIEWS_SIDE))
    pairs = zip(painted(found, views), painted(finest, views), strict=True)
    return {"bytes": len(data), "psnr": float(np.mean([psnr(a, b) for a, b in pairs]))}


def painted(gaussians: PlainGaussians, views: list[Camera]) -> list[Image8]:
    """Images, as in 3DGS, on black."""
    painter = LevelRenderer(PlainModel(gaussians, antialiased=False), CpuRenderer())
    with torch.no_grad():
        return [painter.paint(camera, 0) for camera in views]


def measured(source: Path, rivals: list[Path], sog: bool, keep: Path | None) -> dict[str, object]:
    """Figures of one import."""
    with tempfile.TemporaryDirectory() as folder:
        start, busy = time.perf_counter(), time.process_time()
        made = import_splats(source, keep or Path(folder) / "a.gsyn")
        seconds, cpu = time.perf_counter() - start, time.process_time() - busy
    count = made.splats[-1]
    return {
        "kind": made.kind,
        "splats": made.splats,
        "ends": made.ends,
        "psnr": made.psnr,
        "base_share": made.ends[0] / made.ends[-1],
        "bytes_per_splat": made.ends[-1] / count,
        "seconds_per_million": seconds / count * 1e6,
        "cpu_seconds_per_million": cpu / count * 1e6,
        "load": os.getloadavg()[0],
        "rival_bytes": sum(map(bytes_of, rivals)) or None,
        "sog": sog_of(source) if sog else None,
    }


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rival", type=Path, nargs="*", default=[])
    parser.add_argument("--sog", action="store_true")
    parser.add_argument("--keep", type=Path, help="where the imported file stays")
    options = parser.parse_args()
    figures = measured(options.file, options.rival, options.sog, options.keep)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
