"""A baseline from a scene to a file and a report, as a training of ours leaves them."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic

from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.container import decode
from gsynopsis.container.writer import encode_with_account, publish
from gsynopsis.errors import SettingError
from gsynopsis.evaluation.evaluate import evaluate, measure_quality
from gsynopsis.evaluation.metrics import LearntMeasure
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Provenance, Report
from gsynopsis.evaluation.report_files import write_report
from gsynopsis.files import publish as publish_text
from research.baselines.methods import METHODS, Task
from research.suites.experiment import UNCODED_FILE

FILE = "scene.gsyn"
FRAMES = 20
"""Timed, of each level."""


def run_baseline(
    name: str,
    task: Task,
    out: Path,
    lpips: LearntMeasure | None = None,
    clock: Callable[[], float] = monotonic,
) -> Report:
    """Train a baseline, write its file and the report of its levels on held-out photos.

    Beside them stands what levels had before their values were rounded, `UNCODED_FILE`.

    Args:
        name: Of `METHODS`.
        task: Scene and settings.
        out: A folder that is there.
        lpips: A learnt measure, or None.
        clock: Seconds from any point in time.

    Raises:
        SettingError: there is no such baseline.
        DivergedError: a loss or an image is not finite.
        SpaceError: the disk has no room.
    """
    if name not in METHODS:
        raise SettingError("baseline", found=name, expected=" or ".join(METHODS))
    start = clock()
    with one_torch_thread():
        rival = METHODS[name](task)
        levels = rival.levels
    seconds = clock() - start + (task.kept.seconds if task.kept else 0)
    data, _ = encode_with_account(levels, where=str(out / FILE))
    publish(data, out / FILE)
    known = Provenance(
        preset=name,
        seed=task.seed,
        steps=task.steps + task.level_steps,
        train_seconds=seconds,
        split=task.scene.split,
    )
    device = task.renderer.device
    report = evaluate(
        rival.decoder(decode(data, str(out / FILE))).to(device),
        levels,
        task.scene,
        task.renderer,
        task.scale,
        Options(frames=FRAMES, provenance=known, lpips=lpips),
    )
    report = with_extra(report, rival.extra)
    write_report(report, out)
    scored = (rival.uncoded, levels, task.scene, task.renderer, task.scale)
    uncoded = [quality.psnr for quality in measure_quality(*scored)[1]]
    publish_text(out / UNCODED_FILE, json.dumps(uncoded))
    return report


def with_extra(report: Report, extra: Sequence[int]) -> Report:
    """A report in which levels send values of the levels before anew, one a row, beside the file.

    Args:
        report: As measured.
        extra: Bytes that each level adds to the compact file, coarsest first; empty: none. Other
            accountings get a float32 for each row of the level before.
    """
    scores, packed, rows = list(report.levels), 0, 0
    for number, more in enumerate(extra):
        fresh = scores[number - 1].anchors if number else 0
        packed, rows = packed + more, rows + fresh
        sizes = scores[number].sizes
        grown = {
            f"bytes_{name}": getattr(sizes, f"bytes_{name}") + 4 * rows
            for name in ("paper", "deflate", "raw")
        } | {
            f"delta_{name}": getattr(sizes, f"delta_{name}") + 4 * fresh
            for name in ("paper", "deflate", "raw")
        }
        grown["bytes_compact"] = sizes.bytes_compact + packed
        grown["delta_compact"] = sizes.delta_compact + more
        scores[number] = replace(scores[number], sizes=replace(sizes, **grown))
    return replace(report, levels=tuple(scores))
