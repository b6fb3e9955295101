"""A whole training: phases in order, checkpoints in between, resumable at any step."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from gsynopsis._native.threads import one_torch_thread
from gsynopsis.config import Config
from gsynopsis.errors import CheckpointError
from gsynopsis.train.checkpoint import load_checkpoint, save_checkpoint
from gsynopsis.train.finish import FinishPhase
from gsynopsis.train.full import FullPhase
from gsynopsis.train.joint import JointPhase
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.progress import Observer, StepInfo
from gsynopsis.train.trainer import Trainer, peak_memory
from gsynopsis.train.unfold import UnfoldPhase

CHECKPOINT = "checkpoint.safetensors"
FULL = "full.safetensors"
"""The state at the end of the full training: where `gsynopsis unfold` starts."""


class Phase(Protocol):
    """A stretch of training; all state lives in the trainer."""

    name: str
    steps: int
    settles: bool
    """What it trains is done with it, so that it is worth averaging."""

    def begin(self, trainer: Trainer) -> None:
        """Prepare the model; not called again when the phase is resumed."""
        ...

    def make_optimiser(self, trainer: Trainer) -> Optimiser:
        """A fresh optimiser for the model as it stands; called at the start and on resume."""
        ...

    def step(self, trainer: Trainer) -> None:
        """One step; `trainer.cursor.step` is the number of steps done before it."""
        ...

    def end(self, trainer: Trainer) -> None:
        """Finish the phase."""
        ...


def phases_of(config: Config) -> list[Phase]:
    """What a configuration runs, in order."""
    full, levels = config.train.steps, config.levels
    finish = [FinishPhase(levels.finish)] if levels.finish else []
    if levels.mode == "joint":
        return [FullPhase(full, full + levels.steps), JointPhase(levels.steps, full), *finish]
    last = levels.count - 1
    coarser = [UnfoldPhase(k, levels.steps, last) for k in reversed(range(last))]
    return [FullPhase(full, full), *coarser, *finish]


@one_torch_thread()
def run_training(trainer: Trainer, out: Path, observer: Observer, stop: Callable[[], bool]) -> bool:
    """Train to the end, or to the next step after `stop()` turns true.

    PyTorch is kept on one thread meanwhile: its operations are small here, and its other threads
    would spin against those of the native kernels, which use as many as PyTorch did.

    Args:
        trainer: A fresh trainer; if `out` holds a checkpoint, it is loaded first.
        out: The run's folder, existing; the same one for every process that trains.
        observer: Told of every step.
        stop: Asked after every step.

    Returns:
        True if the training is complete.

    Raises:
        CheckpointError: the checkpoint is of another scene, setting or version.
        DivergedError: the loss is not finite; the last checkpoint is kept.
    """
    phases, path, cursor = phases_of(trainer.config), out / CHECKPOINT, trainer.cursor
    trainer.observer = observer
    moments = {}
    if _resumes(trainer, path):
        moments = load_checkpoint(trainer, path)
        cursor = trainer.cursor
        observer.on_message(f"resuming at {_where(phases, trainer)} from {path}")
    while cursor.phase < len(phases):
        phase = phases[cursor.phase]
        if not cursor.begun:
            phase.begin(trainer)
            cursor.begun, moments = True, {}
        trainer.optimiser = phase.make_optimiser(trainer)
        freeze_others(trainer)
        trainer.optimiser.load(moments)
        if not _run_phase(trainer, phase, path, observer, stop):
            save_checkpoint(trainer, path)
            observer.on_message(f"stopped at {_where(phases, trainer)}; saved {path}")
            return False
        trainer.optimiser.take_average()
        phase.end(trainer)
        cursor.phase, cursor.begun, cursor.step = cursor.phase + 1, False, 0
        if isinstance(phase, FullPhase):
            save_checkpoint(trainer, out / FULL)
        save_checkpoint(trainer, path)
    return True


def _resumes(trainer: Trainer, path: Path) -> bool:
    """Whether there is a checkpoint; all processes have to see the same."""
    there, absent = trainer.world.any(path.exists(), not path.exists())
    if there and absent:
        raise CheckpointError(
            path,
            found="it from some processes only",
            expected="it from all",
            advice="give every machine the same folder as --out",
        )
    return there


def freeze_others(trainer: Trainer) -> None:
    """Gradients for what the optimiser moves and for nothing else, starting from none."""
    assert trainer.model is not None and trainer.optimiser is not None
    moving = {id(p) for p in trainer.optimiser.parameters()}
    for parameter in trainer.model.parameters():
        parameter.requires_grad_(id(parameter) in moving)
        parameter.grad = None


def _run_phase(
    trainer: Trainer, phase: Phase, path: Path, observer: Observer, stop: Callable[[], bool]
) -> bool:
    saved = started = time.monotonic()
    before = trainer.cursor.seconds
    while trainer.cursor.step < phase.steps:
        phase.step(trainer)
        trainer.cursor.step += 1
        if phase.settles:
            _average(trainer, phase)
        now = time.monotonic()
        trainer.cursor.seconds = before + now - started
        observer.on_step(_info(trainer, phase))
        late = now - saved > trainer.config.train.checkpoint_seconds
        stopping, due = trainer.world.any(stop(), late)
        if stopping:
            return False
        if due:
            save_checkpoint(trainer, path)
            saved = now
    return True


def _average(trainer: Trainer, phase: Phase) -> None:
    """Count the step into the means of the last part of the phase, if it is of that part."""
    assert trainer.optimiser is not None
    counted = trainer.cursor.step - round(phase.steps * (1 - trainer.config.train.weight_average))
    if counted > 0:
        trainer.optimiser.average(1 / counted)


def _info(trainer: Trainer, phase: Phase) -> StepInfo:
    assert trainer.model is not None
    return StepInfo(
        phase=phase.name,
        step=trainer.cursor.step,
        steps=phase.steps,
        loss=trainer.cursor.loss,
        psnr=trainer.psnr,
        anchors=len(trainer.model),
        memory=peak_memory(trainer.renderer.device),
    )


def _where(phases: list[Phase], trainer: Trainer) -> str:
    cursor = trainer.cursor
    if cursor.phase >= len(phases):
        return "the end"
    phase = phases[cursor.phase]
    return f"{phase.name} {cursor.step}/{phase.steps}"
