"""One block of a scene, trained in a process of its own from where the whole stands."""

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.config import Config, replaced
from gsynopsis.errors import GsynopsisError
from gsynopsis.files import publish, refuse_link
from gsynopsis.interrupt import stop_on_interrupt
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.plan_blocks import BLOCKS, WHOLE, SpaceBlock, alive
from gsynopsis.jobs.process_pool import PATIENCE
from gsynopsis.jobs.train_run import make_context
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import select_anchors
from gsynopsis.resources.photo_store import photo_store
from gsynopsis.runs.folder import make_folder
from gsynopsis.runs.lock import run_lock
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene, SceneOptions
from gsynopsis.training.checkpoint import load_state
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import CHECKPOINT, FULL, run_training
from gsynopsis.training.observer import Silent, StepInfo
from gsynopsis.training.regularize.exposure import Exposures
from gsynopsis.training.state import TrainState, new_state

STEPS_FILE = "steps"
"""In a block's folder: steps that it has done, as text, while it is trained."""


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
        context = block_context(scene, job.config, job.options, job.block)
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


def block_context(
    scene: Scene, config: Config, options: RunOptions, block: SpaceBlock
) -> TrainContext:
    """Context of a block's training: its photos, its region, a seed of its own."""
    train = replace(config.train, seed=config.train.seed + 1 + block.number)
    seen = replace(scene, train=block.views)
    context = make_context(seen, replace(config, train=train), options)
    return replace(context, region=block.trained)


def whole_config(config: Config) -> Config:
    """Settings of the whole: nothing is pruned for bytes and nothing rounded before the blocks."""
    return replaced(config, {"levels.prune_share": 0.0, "levels.coding_loss": 0.0})


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
    state = seeded_state(context, select_anchors(model, needed & alive(model)))
    if whole.exposures is not None:
        rows = [scene.train.index(view) for view in context.scene.train]
        tensors = {name: t[rows] for name, t in whole.exposures.tensors().items()}
        state.exposures = Exposures(tensors, context.scene.train)
    return state


def seeded_state(context: TrainContext, model: AnchorModel) -> TrainState:
    """A training of a model that has done no step, with the random states of its seed."""
    seed = context.config.train.seed
    return new_state(
        context, model, torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    )
