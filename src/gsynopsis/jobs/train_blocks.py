"""Scenes too large for one training: the whole coarsely, blocks of space each on its own, one file.

The whole is trained first, as any scene. Then each block goes on from it in a process of its own,
on the photos that show it (`training/sub_scene.py`), and what lies in its own box is its part of
the result. Networks and lattice are those of the whole, so joining the parts changes no value.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from gsynopsis._native.runtime import thread_count
from gsynopsis.config import Config, Joint, Recipe, total_steps
from gsynopsis.errors import InputError, SettingError, SpaceError
from gsynopsis.evaluation.report import Report
from gsynopsis.files import refuse_link
from gsynopsis.jobs.decide_exposure import begun_recipe
from gsynopsis.jobs.join_blocks import FromBlocks, Joined
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.plan_blocks import (
    BLOCKS,
    WHOLE,
    SpaceBlock,
    check_plan,
    plan_blocks,
    write_plan,
)
from gsynopsis.jobs.process_pool import on_ray, on_this_machine
from gsynopsis.jobs.start import Fresh, Start
from gsynopsis.jobs.train_block import (
    STEPS_FILE,
    BlockJob,
    steps_written,
    train_block,
    whole_config,
)
from gsynopsis.jobs.train_run import make_context, train_run
from gsynopsis.runs.folder import RESULT_FILE
from gsynopsis.runs.lock import LOCK_FILE
from gsynopsis.scene.scene import Scene
from gsynopsis.training.checkpoint import load_state, recorded_phase
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import world_size
from gsynopsis.training.loop import CHECKPOINT, phases_of
from gsynopsis.training.observer import Observer

RETRIES = 3
"""Times that blocks are begun again after a process was killed."""
BLOCKS_MOST = 1000
JOBS_MOST = 256


@dataclass(frozen=True)
class Division:
    """Division of a scene into blocks, and who trains them.

    Attributes:
        count: Blocks, 2 to 1,000.
        jobs: Blocks at once, each in a process.
        ray: Address of a Ray cluster that trains them instead, or `local`.
    """

    count: int
    jobs: int = 1
    ray: str | None = None

    def __post_init__(self) -> None:
        if not 2 <= self.count <= BLOCKS_MOST:
            raise SettingError("--blocks", found=self.count, expected=f"2 to {BLOCKS_MOST:,}")


def division_of(blocks: int, jobs: int, ray: str | None, options: RunOptions) -> Division | None:
    """The division that was asked for; None: one training.

    Raises:
        SettingError: options that go only with blocks, or not with them.
    """
    if not 1 <= jobs <= JOBS_MOST:
        raise SettingError("--jobs", found=jobs, expected=f"1 to {JOBS_MOST:,}")
    if not blocks:
        if jobs > 1 or ray:
            name = "--ray" if ray else "--jobs"
            raise SettingError(name, found="no blocks", expected="--blocks N")
        return None
    if options.viewer_port is not None or options.tensorboard:
        name = "--tensorboard" if options.viewer_port is None else "--viewer"
        raise SettingError(name, found="--blocks", expected="one training")
    if world_size() > 1:
        raise SettingError("--blocks", found="torchrun", expected="one process, see --jobs")
    return Division(blocks, jobs, ray)


def train_in_blocks(
    context: TrainContext,
    recipe: Recipe,
    out: Path,
    division: Division,
    options: RunOptions,
    observer: Observer,
) -> Report | None:
    """Train the whole, then its blocks, and join them into one file; each step resumes.

    Args:
        context: Scene, settings and machinery of the run.
        recipe: Joint levels, without a codebook, sizes not ordered.
        out: Folder of the run.
        division: Number of blocks, and who trains them.
        options: Options of all trainings; memory is shared by those at once.
        observer: Hears of everything.

    Returns:
        The report, if one was ordered.

    Raises:
        KeyboardInterrupt: the user stopped it; everything so far is saved.
        InputError: blocks failed, which are named; the others are kept, and so is the whole.
        SettingError: such settings cannot be trained in blocks, or the folder has other blocks.
        SpaceError: processes were killed again and again.
    """
    check_divisible(recipe.config)
    scene, out = context.scene, out.resolve()
    for name in (WHOLE, BLOCKS):
        refuse_link(out / name)
    check_plan(out, division.count)
    whole = replace(recipe, config=whole_config(recipe.config))
    _check_share(scene, whole.config, options, division)
    _train_whole(scene, whole, out / WHOLE, observer, options)
    # What the whole decided holds for the blocks.
    recipe, whole = (begun_recipe(own, out / WHOLE) for own in (recipe, whole))
    context = make_context(scene, recipe.config, options)
    start: Start = Joined()
    if recorded_phase(out / CHECKPOINT) < 0:
        state = load_state(make_context(scene, whole.config, options), out / WHOLE / CHECKPOINT)
        state.observer = observer
        blocks = plan_blocks(state, division.count)
        write_plan(out, blocks)
        _train_all(scene, recipe.config, out, blocks, division, observer, options)
        start = FromBlocks(state, tuple(blocks), options)
    return train_run(context, recipe, out, start, options, observer)


def check_divisible(config: Config) -> None:
    """Refuse what blocks cannot be made of.

    Raises:
        SettingError: it is that.
    """
    levels, model = config.levels, config.model
    codebook = 0 if model.feature == "free" else model.codebook
    wrong = [
        ("levels.mode", not isinstance(levels, Joint), levels.mode, "joint"),
        ("levels.level_mib", bool(levels.level_bytes), "ordered sizes", "none"),
        ("model.codebook", codebook > 0, codebook, "0"),
    ]
    for name, refused, found, expected in wrong:
        if refused:
            raise SettingError(name, found=found, expected=f"{expected}, with --blocks")


def _train_whole(
    scene: Scene, recipe: Recipe, out: Path, observer: Observer, options: RunOptions
) -> None:
    # A kill comes also between the last checkpoint and the file.
    if _is_trained(out, recipe.config) and (out / RESULT_FILE).is_file():
        return
    observer.on_message(f"the whole first, into {out}")
    options = replace(options, evaluate=False, tensorboard=False)
    context = make_context(scene, recipe.config, options)
    train_run(context, recipe, out, Fresh(), options, observer)


def _is_trained(folder: Path, config: Config) -> bool:
    """True if a training is over and what it needed is removed: a lock is left if it was killed."""
    ended = recorded_phase(folder / CHECKPOINT) == len(phases_of(config))
    return ended and not (folder / LOCK_FILE).exists()


def _train_all(
    scene: Scene,
    config: Config,
    out: Path,
    blocks: Sequence[SpaceBlock],
    division: Division,
    observer: Observer,
    options: RunOptions,
) -> None:
    """Train all blocks that are not trained yet.

    Raises:
        InputError: some could not be trained.
        KeyboardInterrupt: they were stopped.
    """
    told = replace(options, max_memory=_share(options, division), evaluate=False)
    jobs = dict(_jobs(scene, config, out, blocks, division, told))
    steps, left, failed = total_steps(config), set(jobs), dict[int, str]()
    for block in blocks:
        with suppress(OSError):
            (out / BLOCKS / block.folder / STEPS_FILE).unlink()

    def look() -> None:
        ended = steps * (len(jobs) - len(left))
        under_way = sum(steps_written(out / BLOCKS / blocks[number].folder) for number in left)
        observer.on_pass("steps in blocks", ended + under_way, steps * len(jobs))

    for number, reason in _ended(jobs, division, look):
        left.discard(number)
        if reason:
            failed[number] = reason
        become = reason or "trained"
        observer.on_message(f"block {number}: {become}, {len(left)} of {len(jobs)} to come")
    if "stopped" in failed.values():
        raise KeyboardInterrupt
    if failed:
        number, reason = min(failed.items())
        more = f" and {len(failed) - 1} more" if len(failed) > 1 else ""
        raise InputError(
            out / BLOCKS,
            f"block {number}{more}",
            found=reason,
            expected="a trained block",
            advice="the others are kept: repeat the command; the whole is in "
            f"{out / WHOLE / 'scene.gsyn'}",
        )


def _jobs(
    scene: Scene,
    config: Config,
    out: Path,
    blocks: Sequence[SpaceBlock],
    division: Division,
    options: RunOptions,
) -> Iterator[tuple[int, tuple[BlockJob]]]:
    together = 1 if division.ray else division.jobs
    threads = max(1, thread_count() // together)
    for block in blocks:
        if block.views and not _is_trained(out / BLOCKS / block.folder, config):
            root = scene.root.resolve()
            job = BlockJob(root, scene.reading, config, out, block, options, threads)
            yield block.number, (job,)


def _check_share(scene: Scene, config: Config, options: RunOptions, division: Division) -> None:
    """Refuse a limit too small for each block before the whole is trained.

    Raises:
        SpaceError: not even the anchors of the start fit.
    """
    try:
        make_context(scene, config, replace(options, max_memory=_share(options, division)))
    except SpaceError as error:
        if options.max_memory is None or _share(options, division) == options.max_memory:
            raise
        found = f"{options.max_memory:g} GiB for {division.jobs} jobs"
        raise SpaceError(
            "--max-memory",
            found=found,
            expected=f"for each {error.expected}",
            advice=f"use fewer --jobs, or {error.advice}",
        ) from error


def _share(options: RunOptions, division: Division) -> float | None:
    """GiB that each process that trains a block may take; machines of a cluster have it all."""
    if options.max_memory is None or division.ray:
        return options.max_memory
    return options.max_memory / division.jobs


def _ended(
    jobs: Mapping[int, tuple[BlockJob]], division: Division, look: Callable[[], None]
) -> Iterator[tuple[int, str]]:
    """Blocks as they end."""
    if not jobs:
        return iter(())
    if division.ray:
        return on_ray(train_block, jobs, division.ray, look)
    return on_this_machine(train_block, jobs, division.jobs, RETRIES, look)
