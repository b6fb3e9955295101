"""A baseline from a scene to a file and a report, as a training of ours leaves them."""

from collections.abc import Callable
from pathlib import Path
from time import monotonic

from gsynopsis._native.threads import one_torch_thread
from gsynopsis.container import decode
from gsynopsis.container.writer import encode_with_account, publish
from gsynopsis.errors import SettingError
from gsynopsis.evaluation.evaluate import evaluate
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Provenance, Report
from gsynopsis.evaluation.report_files import write_report
from gsynopsis.model.splats import decoder_of
from research.baselines.methods import METHODS, Task
from research.baselines.octree import gated

FILE = "scene.gsyn"
FRAMES = 20
"""Timed, of each level."""


def run_baseline(
    name: str, task: Task, out: Path, clock: Callable[[], float] = monotonic
) -> Report:
    """Train a baseline, write its file and the report of its levels on held-out photos.

    Args:
        name: Of `METHODS`.
        task: Scene and settings.
        out: A folder that is there.
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
        levels = METHODS[name](task)
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
    device, inside = task.renderer.device, task.scene.inside if task.scene.masked else None
    report = evaluate(
        gated(decoder_of(decode(data, str(out / FILE))), levels.meta).to(device),
        levels,
        task.scene,
        task.renderer,
        task.scale,
        Options(frames=FRAMES, provenance=known, inside=inside),
    )
    write_report(report, out)
    return report
