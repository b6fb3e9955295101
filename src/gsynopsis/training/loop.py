"""A whole training: phases in order, checkpoints in between, resumable at any step."""

import resource
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import torch

from gsynopsis._native.runtime import one_torch_thread, reused
from gsynopsis.config import Config, Joint
from gsynopsis.errors import CheckpointError
from gsynopsis.training.checkpoint import load_state, save_checkpoint
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.observer import Observer, StepInfo
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.phases.joint import JointPhase
from gsynopsis.training.phases.sequential import UnfoldPhase
from gsynopsis.training.state import TrainState, bring_home, fresh_state, set_optimizer
from gsynopsis.training.step import sync_losses

CHECKPOINT = "checkpoint.safetensors"
FULL = "full.safetensors"
"""The state at the end of the full training: where `gsynopsis unfold` starts."""
CHECKPOINT_SECONDS = 120.0
"""Training time between checkpoints: at most this is lost on a power cut (ours)."""


class Phase(Protocol):
    """A stretch of training; it holds its settings, and all else is in the state."""

    name: str
    steps: int
    averages: bool
    """True if weights are averaged at its end: it is the last to train them."""

    def begin(self, state: TrainState) -> None:
        """Prepare the model; not called again when the phase is resumed."""
        ...

    def make_optimizer(self, state: TrainState) -> Optimizer:
        """A fresh optimizer for the model as it stands; called at the start and on resume."""
        ...

    def step(self, state: TrainState) -> None:
        """One step; `state.progress.step` is the number of steps done before it."""
        ...

    def end(self, state: TrainState) -> None:
        """Finish the phase."""
        ...


def phases_of(config: Config) -> list[Phase]:
    """The phases of a training, in order."""
    full, levels = config.train.steps, config.levels
    if isinstance(levels, Joint):
        return [FullPhase(full, full + levels.steps), JointPhase(levels, full)]
    last = levels.count - 1
    coarser = [UnfoldPhase(k, levels, last) for k in reversed(range(last))]
    return [FullPhase(full, full), *coarser]


@one_torch_thread()
def open_state(context: TrainContext, out: Path, observer: Observer) -> TrainState:
    """The training of a folder: from its checkpoint, or fresh if there is none.

    Args:
        context: What the training is given.
        out: The run's folder, the same one for every process that trains.
        observer: Receives the step at which a checkpoint goes on.

    Raises:
        CheckpointError: the checkpoint is of another scene, setting or version, or damaged.
        SceneError: the scene has no point to begin with.
    """
    path = out / CHECKPOINT
    if not _resumes(context.group, path):
        state = fresh_state(context)
    else:
        state = load_state(context, path)
        observer.on_message(f"resuming at {_where(phases_of(context.config), state)} from {path}")
    state.observer = observer
    return state


@reused()
@one_torch_thread()
def run_training(
    state: TrainState,
    out: Path,
    observer: Observer,
    stop: Callable[[], bool],
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
) -> bool:
    """Train to the end, or to the next step after `stop()` turns true.

    PyTorch is kept on one thread meanwhile: its operations are small here, and its other threads
    would spin against those of the native kernels, which use PyTorch's former number.

    Args:
        state: See `open_state`; it is moved.
        out: The run's folder, existing; the same one for every process that trains.
        observer: Receives every step.
        stop: Asked after every step.
        checkpoint_seconds: Between checkpoints; there is one at the end of each phase too.

    Returns:
        True if the training is complete.

    Raises:
        DivergedError: the loss is not finite; the last checkpoint is kept.
        SpaceError: there is no room for a checkpoint.
        PeerError: another process stopped.
    """
    phases, path, cursor = phases_of(state.context.config), out / CHECKPOINT, state.progress
    state.observer = observer
    try:
        while cursor.phase < len(phases):
            phase = phases[cursor.phase]
            # A resumed run may be inside the phase already.
            if not cursor.begun:
                with _timed(state):
                    phase.begin(state)
                # Adam's moments of the phase before are of other parameters, or of other rows.
                cursor.begun, state.moments = True, {}
            set_optimizer(state, phase.make_optimizer(state))
            if not _run_phase(state, phase, path, stop, checkpoint_seconds):
                save_checkpoint(state, path)
                observer.on_message(f"stopped at {_where(phases, state)}; saved {path}")
                return False
            with _timed(state):  # ranking, sensitivity and rounding are training, too
                bring_home(state)
                state.optimizer.take_average()
                phase.end(state)
            # `cursor.seconds` counts over all phases and resumed runs; the rest is this phase's.
            before = sum(cursor.phase_seconds.values())
            cursor.phase_seconds[phase.name] = cursor.seconds - before
            cursor.phase, cursor.begun, cursor.step = cursor.phase + 1, False, 0
            # `unfold` and longer runs start from the full model; the next checkpoint replaces it.
            if isinstance(phase, FullPhase):
                save_checkpoint(state, out / FULL)
            save_checkpoint(state, path)
        return True
    finally:
        # Ends the thread that copies photos to the GPU, after an error too.
        if state.photos is not None:
            state.photos.close()


def peak_memory(device: torch.device) -> int:
    """Peak resident memory of this process, or of the GPU, bytes."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


@contextmanager
def _timed(state: TrainState) -> Generator[None]:
    """Counts the `with` block into the training's seconds."""
    started = time.monotonic()
    yield
    state.progress.seconds += time.monotonic() - started


def _resumes(group: ProcessGroup, path: Path) -> bool:
    """True if there is a checkpoint; all processes must see the same."""
    there, absent = group.any(path.exists(), not path.exists())
    if there and absent:
        raise CheckpointError(
            path,
            found="it from some processes only",
            expected="it from all",
            advice="give every machine the same folder as --out",
        )
    return there


def _run_phase(
    state: TrainState,
    phase: Phase,
    path: Path,
    stop: Callable[[], bool],
    checkpoint_seconds: float,
) -> bool:
    saved = started = time.monotonic()
    # Seconds of earlier runs come with the checkpoint; the clock counts only this one.
    before = state.progress.seconds
    while state.progress.step < phase.steps:
        phase.step(state)
        state.progress.step += 1
        if phase.averages:
            _average(state, phase)
        now = time.monotonic()
        state.progress.seconds = before + now - started
        state.observer.on_step(_info(state, phase))
        # All ranks decide together: saving is collective, and clocks and signals differ.
        stopping, due = state.context.group.any(stop(), now - saved > checkpoint_seconds)
        if stopping or due or state.progress.step == phase.steps:
            sync_losses(state)  # what diverged must not be saved
        if stopping:
            return False
        if due:
            save_checkpoint(state, path)
            saved = now
    return True


def _average(state: TrainState, phase: Phase) -> None:
    """Weight averaging: count the step in, if it is of the last part of the phase."""
    share = state.context.config.train.weight_average
    # Late steps only: early weights are far from the end and would bias the mean.
    counted = state.progress.step - round(phase.steps * (1 - share))
    if counted > 0:
        if state.whole is not None:
            state.whole.average(state.optimizer, 1 / counted)
        else:
            state.optimizer.average(1 / counted)


def _info(state: TrainState, phase: Phase) -> StepInfo:
    return StepInfo(
        phase=phase.name,
        step=state.progress.step,
        steps=phase.steps,
        loss=state.progress.loss,
        psnr=state.progress.psnr,
        anchors=len(state.model),
        memory=peak_memory(state.context.renderer.device),
    )


def _where(phases: Sequence[Phase], state: TrainState) -> str:
    cursor = state.progress
    if cursor.phase >= len(phases):
        return "the end"
    phase = phases[cursor.phase]
    return f"{phase.name} {cursor.step}/{phase.steps}"
