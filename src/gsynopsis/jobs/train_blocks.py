"""Scenes too large for one training: the whole coarsely, blocks of space each on its own, one file.

The whole is trained first, as any scene. Then each block goes on from it in a process of its own,
on the photos that show it (`training/sub_scene.py`), and what lies in its own box is its part of
the result. Networks and lattice are those of the whole, so joining the parts changes no value.
"""

import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gsynopsis._native.threads import one_torch_thread, thread_count
from gsynopsis.config import (
    Config,
    Joint,
    Recipe,
    replaced,
    total_steps,
)
from gsynopsis.errors import GsynopsisError, InputError, SettingError, SpaceError
from gsynopsis.evaluation.report import Report
from gsynopsis.files import publish, refuse_link
from gsynopsis.jobs.decide_exposure import begun_recipe
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.process_pool import PATIENCE, on_ray, on_this_machine
from gsynopsis.jobs.start import Fresh, Start
from gsynopsis.jobs.train_run import make_context, train_run
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel
from gsynopsis.model.build import select_anchors
from gsynopsis.render.base import blend_weights
from gsynopsis.resources.photo_store import photo_store
from gsynopsis.runs.folder import make_folder
from gsynopsis.runs.interrupt import stop_on_interrupt
from gsynopsis.runs.lock import run_lock
from gsynopsis.scene.scene import Scene, SceneOptions, load_scene
from gsynopsis.training.checkpoint import load_state, recorded_phase, save_checkpoint
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import world_size
from gsynopsis.training.loop import CHECKPOINT, FULL, phases_of, run_training
from gsynopsis.training.observer import Observer, Silent, StepInfo
from gsynopsis.training.regularize.exposure import Exposures
from gsynopsis.training.state import Progress, TrainState, new_state
from gsynopsis.training.sub_scene import Region, extents, split_space

WHOLE, BLOCKS, PLAN = "whole", "blocks", "plan.json"
"""In a run's folder: the run of the whole, folders of blocks by number, how they were divided."""
STEPS_FILE = "steps"
"""In a block's folder: steps that it has done, as text, while it is trained."""
MARGIN = 0.1
"""Share of a block's size, on each side, in which it trains anchors that are not its own."""
SHOWN = 0.05
"""A photo is of a block where the block and its margin fill this share of it."""
FEWEST_PHOTOS = 8
"""A block gets as many, those that show most of it, where fewer show enough."""
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


@dataclass(frozen=True)
class SpaceBlock:
    """A part of a scene.

    Attributes:
        number: From 0.
        own: What of the result is its.
        trained: Its own box with a margin: anchors in there it trains.
        views: Training photos that show it; none: it stays as the whole has it.
    """

    number: int
    own: Region
    trained: Region
    views: tuple[int, ...]

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return f"{self.number:04d}"


@dataclass(frozen=True)
class BlockJob:
    """All that a process needs to train a block.

    Attributes:
        scene: Folder of the scene.
        reading: How it is read.
        config: Settings of the run.
        run: Folder of the run.
        block: Which.
        options: Renderer, memory, checkpoints, cache.
        threads: Of this process.
    """

    scene: Path
    reading: SceneOptions
    config: Config
    run: Path
    block: SpaceBlock
    options: RunOptions
    threads: int


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
    _check_plan(out, division.count)
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
        _write_plan(out, blocks)
        _train_all(scene, recipe.config, out, blocks, division, observer, options)
        start = FromBlocks(state, tuple(blocks), options)
    return train_run(context, recipe, out, start, options, observer)


@dataclass(frozen=True)
class FromBlocks:
    """Trained blocks, joined into one model at the last step of the run.

    Attributes:
        whole: The trained whole; its model is taken.
        blocks: All blocks; one without photos is as the whole has it.
        options: Options that the blocks were trained with.
    """

    whole: TrainState
    blocks: tuple[SpaceBlock, ...]
    options: RunOptions

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        joined = join_blocks(context, self.whole, self.blocks, out, self.options)
        save_checkpoint(joined, out / CHECKPOINT)
        return f"joined {len(self.blocks)} blocks: {len(joined.model):,} anchors"


@dataclass(frozen=True)
class Joined:
    """Blocks that were joined before: the folder's own checkpoint."""

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        return ""


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


def whole_config(config: Config) -> Config:
    """Settings of the whole: nothing is pruned for bytes and nothing rounded before the blocks."""
    return replaced(config, {"levels.prune_share": 0.0, "levels.coding_loss": 0.0})


def plan_blocks(state: TrainState, count: int) -> list[SpaceBlock]:
    """Divide a trained whole by its anchors, and photos by what they show.

    Raises:
        SettingError: there are fewer anchors than blocks.
    """
    model, scene = state.model, state.context.scene
    placed = model.placed()[0]
    x = placed[_alive(model)].cpu().numpy()
    if len(x) < 2 * count:
        raise SettingError("--blocks", found=count, expected=f"at most {len(x) // 2} here")
    own = split_space(x, count)
    trained: list[Region] = []
    for box in own:
        inside = x[box.holds(torch.from_numpy(x)).numpy()]
        trained.append(box.wider((MARGIN * extents(inside)).tolist()))
    member = torch.stack([box.holds(placed) for box in trained], dim=1).float()  # [N, B]
    shares = np.stack([_shares(state, view, member) for view in scene.train])  # [V, B]
    return [
        SpaceBlock(number, box, trained[number], views_of(scene.train, shares[:, number]))
        for number, box in enumerate(own)
    ]


def _shares(state: TrainState, view: int, member: Tensor) -> np.ndarray:
    """Share of a view that each block fills, float64 [B]; `member` [N, B] assigns anchors."""
    camera, model = state.context.scene.camera(view, state.context.config.scale), state.model
    with torch.no_grad():
        decoded = model.decode_level(-1, camera)
    weights = blend_weights(state.context.renderer, decoded.gaussians, camera)
    filled = weights[None] @ member[decoded.slots // model.slots]
    return filled[0].double().cpu().numpy() / (camera.width * camera.height)


def views_of(train: Sequence[int], shares: np.ndarray) -> tuple[int, ...]:
    """Views that show a block, ascending."""
    best = np.argsort(-shares, kind="stable")
    enough = int((shares >= SHOWN).sum())
    chosen = best[: max(enough, min(FEWEST_PHOTOS, int((shares > 0).sum())))]
    return tuple(train[i] for i in sorted(chosen.tolist()))


def train_block(job: BlockJob) -> str:
    """Train a block, or go on where it was stopped; why it could not be, or "".

    It stops, resumable, when it is asked to or when the process that ordered it is gone.
    """
    parent, folder = os.getppid(), job.run / BLOCKS / job.block.folder
    try:
        torch.set_num_threads(job.threads)
        scene = load_scene(job.scene, job.config.split, job.reading)
        refuse_link(folder)
        make_folder(folder)
        context = block_setup(scene, job.config, job.options, job.block)
        with (
            stop_on_interrupt(alone=False) as asked,
            run_lock(folder),
            one_torch_thread(),
        ):
            state = _open_block(scene, context, job, folder)
            with photo_store(context, folder, job.options.cache, lambda text: None) as forget:

                def stop() -> bool:
                    return asked() or os.getppid() != parent

                seconds = job.options.checkpoint_seconds
                if not run_training(state, folder, StepsWritten(folder), stop, seconds):
                    return "stopped"
                forget()
            for name in (FULL, STEPS_FILE):
                (folder / name).unlink(missing_ok=True)
    except (GsynopsisError, OSError) as error:
        return str(error)
    return ""


class StepsWritten(Silent):
    """Writes how many steps a block has done, for the process that waits for it."""

    def __init__(self, folder: Path) -> None:
        """`folder` is the block's."""
        self.path, self.done, self._next = folder / STEPS_FILE, 0, 0.0

    def on_step(self, info: StepInfo) -> None:
        """Count it, and write now and then."""
        self.done += 1
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + PATIENCE
            publish(self.path, str(self.done))


def steps_written(folder: Path) -> int:
    """Steps that a block has done since it was begun or went on; 0 where it has not yet said so."""
    try:
        return int((folder / STEPS_FILE).read_text("ascii"))
    except (OSError, ValueError):
        return 0


def block_setup(
    scene: Scene, config: Config, options: RunOptions, block: SpaceBlock
) -> TrainContext:
    """Context of a block's training: its photos, its region, a seed of its own."""
    train = replace(config.train, seed=config.train.seed + 1 + block.number)
    seen = replace(scene, train=block.views)
    context = make_context(seen, replace(config, train=train), options)
    return replace(context, region=block.trained)


@one_torch_thread()
def join_blocks(
    context: TrainContext,
    whole: TrainState,
    blocks: Sequence[SpaceBlock],
    run: Path,
    options: RunOptions,
) -> TrainState:
    """One training out of all blocks: of each what is its own; at its last step.

    Args:
        context: Of the run.
        whole: The trained whole; its model is taken.
        blocks: All of them; one without photos is as the whole has it.
        run: Folder of the run.
        options: As the blocks were trained.
    """
    models: list[AnchorModel] = []
    seconds = whole.progress.seconds
    for block in blocks:
        state = whole
        if block.views:
            of_block = block_setup(context.scene, context.config, options, block)
            state = load_state(of_block, run / BLOCKS / block.folder / CHECKPOINT)
            seconds += state.progress.seconds
        models.append(select_anchors(state.model, block.own.holds(state.model.placed()[0])))
    model = whole.model
    with torch.no_grad():
        model.set_lattice(torch.cat([m.lattice for m in models]))
        for name in ROW_PARAMETERS:
            rows = torch.cat([getattr(m, name) for m in models])
            setattr(model, name, torch.nn.Parameter(rows))
        for level, part in enumerate(model.level_parts()):
            part.mask = torch.cat([m.part(level).mask for m in models])
    phases, joined = phases_of(context.config), _seeded(context, model)
    joined.exposures = whole.exposures
    last = len(phases) - 1
    joined.progress = Progress(phase=last, begun=True, step=phases[last].steps, seconds=seconds)
    joined.progress.phase_seconds = {phase.name: 0.0 for phase in phases[:-1]}
    return joined


def _seeded(context: TrainContext, model: AnchorModel) -> TrainState:
    """A training of a model that has done no step, with the random states of its seed."""
    seed = context.config.train.seed
    return new_state(
        context, model, torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    )


def _alive(model: AnchorModel) -> Tensor:
    """Anchors that any level has, bool [N]."""
    return torch.stack([part.mask for part in model.level_parts()]).any(dim=0).any(dim=1)


def _open_block(scene: Scene, context: TrainContext, job: BlockJob, folder: Path) -> TrainState:
    """From its checkpoint, or from the whole without what its photos never show."""
    if (folder / CHECKPOINT).exists():
        return load_state(context, folder / CHECKPOINT)
    config = whole_config(job.config)
    whole = load_state(make_context(scene, config, job.options), job.run / WHOLE / CHECKPOINT)
    model = whole.model
    needed = job.block.trained.holds(model.placed()[0])
    for view in context.scene.train:
        camera = context.scene.camera(view, context.config.scale)
        needed[model.visible(model.part(-1), camera)] = True
    state = _seeded(context, select_anchors(model, needed & _alive(model)))
    if whole.exposures is not None:
        rows = [scene.train.index(view) for view in context.scene.train]
        tensors = {name: t[rows] for name, t in whole.exposures.tensors().items()}
        state.exposures = Exposures(tensors, context.scene.train)
    return state


def _train_whole(
    scene: Scene, recipe: Recipe, out: Path, observer: Observer, options: RunOptions
) -> None:
    if recorded_phase(out / CHECKPOINT) == len(phases_of(recipe.config)):
        return
    observer.on_message(f"the whole first, into {out}")
    options = replace(options, evaluate=False, tensorboard=False)
    context = make_context(scene, recipe.config, options)
    train_run(context, recipe, out, Fresh(), options, observer)


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
        path = out / BLOCKS / block.folder / CHECKPOINT
        if block.views and recorded_phase(path) < len(phases_of(config)):
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


def _check_plan(out: Path, count: int) -> None:
    """Refuse a folder that holds something else.

    Raises:
        SettingError: it does.
    """
    path, advice = out / BLOCKS / PLAN, "repeat the command as it was, or choose another --out"
    if not path.is_file():
        if (out / CHECKPOINT).exists():
            raise SettingError(out, found="a run without blocks", expected="none", advice=advice)
        return
    try:
        before = len(json.loads(path.read_text("utf-8"))["blocks"])
    except (ValueError, KeyError, TypeError) as error:
        raise SettingError(path, found=error, expected="a plan of blocks", advice=advice) from error
    if before != count:
        raise SettingError(out, "--blocks", found=count, expected=f"{before}", advice=advice)


def _write_plan(out: Path, blocks: Sequence[SpaceBlock]) -> None:
    """For people, and to know the number of blocks again; infinite sides are null."""
    make_folder(out / BLOCKS)

    def box(region: Region) -> dict[str, list[float | None]]:
        sides = asdict(region)
        return {k: [x if math.isfinite(x) else None for x in v] for k, v in sides.items()}

    told = [{"own": box(b.own), "trained": box(b.trained), "views": b.views} for b in blocks]
    publish(out / BLOCKS / PLAN, json.dumps({"blocks": told}, indent=1) + "\n")
