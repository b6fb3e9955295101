"""A finished run as one file again."""

from contextlib import ExitStack
from pathlib import Path

from gsynopsis.container.annotate import annotate, annotations_of, read_annotations
from gsynopsis.container.coding import Coding
from gsynopsis.container.notes.annotations import annotations_text
from gsynopsis.errors import InputError
from gsynopsis.jobs.manifest_notes import Up
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.train_run import make_context
from gsynopsis.jobs.write_file import Box, Packing, write_file
from gsynopsis.monitor.display import Display
from gsynopsis.runs.folder import Run, read_run, recorded_config, scene_of_run
from gsynopsis.training.checkpoint import load_state
from gsynopsis.training.loop import CHECKPOINT, phases_of
from gsynopsis.training.observer import Observer


def pack(  # noqa: PLR0913 -- flat keywords, as people call it
    run: Run | Path | str,
    out: Path | str | None = None,
    *,
    coding: Coding = "compact",
    block: int = 0,
    licence: str = "",
    crop: Box | None = None,
    up: Up | None = None,
    notes: Path | str | None = None,
    observer: Observer | None = None,
    quiet: bool = False,
) -> Path:
    """Write a finished run's levels as one file again, in either coding.

    Args:
        run: A finished run.
        out: The file; None replaces the run's own.
        coding: `compact` (few bits, live slots only), or `raw` (float32, exact).
        block: Largest number of anchors of a spatial block; 0 for the default.
        licence: What others may do with the scene, as text that the file carries; "" for none.
        crop: Corners of a box, world units: what lies outside is left out; None: nothing is.
        up: Away from the ground, not zero; None: as the cameras have it.
        notes: A file of annotations, JSON; None: those that the run's own file has stay.
        observer: Hears of progress; None shows a bar.
        quiet: Show no progress bar.

    Raises:
        InputError: the run has no checkpoint, or is not finished.
        SettingError: a keyword has a value that cannot be.
        SpaceError: the disk has no room.

    Examples:
        >>> path = gs.pack("runs/room", "again.gsyn")
        >>> len(gs.check(path))
        4
    """
    content = None if notes is None else read_annotations(Path(notes))
    packing = Packing(coding, block, licence, crop, up)
    run = run if isinstance(run, Run) else read_run(Path(run))
    checkpoint = run.folder / CHECKPOINT
    if run.scene is None or not checkpoint.is_file():
        raise InputError(checkpoint, found="nothing", expected="the checkpoint of a run")
    config = recorded_config(run.folder)
    context = make_context(scene_of_run(run, config.split), config, RunOptions())
    state = load_state(context, checkpoint)
    if state.progress.phase < len(phases_of(config)):
        advice = "repeat its train command first"
        raise InputError(checkpoint, found="an unfinished run", advice=advice)
    path = run.file if out is None else Path(out)
    content = annotations_of(run.file) if content is None else content
    annotations_text(content, notes or run.file)  # before the long work
    with ExitStack() as shown:
        if observer is None:
            observer = shown.enter_context(Display(quiet=quiet))
        write_file(state, run.preset or "standard", path, packing, tick=observer.on_pass)
    if content != "[]":
        annotate(path, content, notes or run.file)
    return path
