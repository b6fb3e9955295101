"""A setting tried both ways from one checkpoint, judged by training photos that are held back.

What switches itself on proves itself on photos of that very scene: a model is begun on the others,
goes on in two ways, and the plain PSNR on the held-back photos decides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.scene.scene import Scene
from gsynopsis.training.checkpoint import load_state, save_checkpoint
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import phases_of
from gsynopsis.training.observer import Observer, Silent
from gsynopsis.training.regularize.exposure import Exposures
from gsynopsis.training.state import TrainState, fresh_state, set_optimizer
from gsynopsis.training.step import sync_losses
from gsynopsis.training.view_step import background_of, compare, load_target, mean_squared_error

HELD_BACK = 10
"""One training photo in this many is held back."""
FEWEST_HELD = 3
FEWEST_LEFT = 6
"""Photos to train on without which nothing is tried."""
STEPS = 300
"""Before the fork, and after it on either side."""
STEPS_SHARE = 0.2
"""Most steps of each of the three trainings, as a share of the full model's."""
FEWEST_STEPS = 50
"""Fewer show nothing."""


@dataclass(frozen=True)
class Fork:
    """PSNR of held-back training photos, dB, one per photo.

    Attributes:
        off: Without the change on trial.
        on: With it.
    """

    off: tuple[float, ...]
    on: tuple[float, ...]

    @property
    def gain(self) -> float:
        """Mean PSNR with it above that without, dB."""
        return float(np.mean(self._gains))

    @property
    def doubt(self) -> float:
        """Standard error of that mean, by how photos differ in it, dB."""
        return float(np.std(self._gains, ddof=1) / len(self.on) ** 0.5)

    @property
    def _gains(self) -> NDArray[np.float64]:
        return np.array(self.on) - np.array(self.off)


def fork_exposure(
    context: TrainContext, observer: Observer, stop: Callable[[], bool] = lambda: False
) -> Fork | None:
    """PSNR with and without solved exposure, from one model; None: too few photos or steps.

    Args:
        context: Of the training that is about to begin; one process.
        observer: Told of progress.
        stop: Asked after each step.

    Raises:
        KeyboardInterrupt: `stop` said so.
    """
    steps = min(STEPS, round(STEPS_SHARE * context.config.train.steps))
    scene = held_back(context.scene)
    if steps < FEWEST_STEPS or scene is None:
        return None
    train = replace(context.config.train, exposure="off")
    tried = replace(context, scene=scene, config=replace(context.config, train=train))
    done = 0

    def told() -> None:
        nonlocal done
        done += 1
        observer.on_pass("trying exposure on held-back photos", done, 3 * steps)
        if stop():
            raise KeyboardInterrupt

    with TemporaryDirectory() as folder, one_torch_thread():
        return _fork(tried, steps, Path(folder) / "fork.safetensors", told)


def held_back(scene: Scene) -> Scene | None:
    """The scene with some training photos as test photos; None: it has too few."""
    count = max(FEWEST_HELD, len(scene.train) // HELD_BACK)
    if len(scene.train) - count < FEWEST_LEFT:
        return None
    rows = (np.arange(count) * 2 + 1) * len(scene.train) // (2 * count)
    held = tuple(scene.train[row] for row in rows)
    left = tuple(view for view in scene.train if view not in held)
    return replace(scene, train=left, test=held)


def _fork(context: TrainContext, steps: int, path: Path, told: Callable[[], None]) -> Fork:
    begun = fresh_state(context)
    phase = phases_of(context.config)[0]
    phase.begin(begun)
    begun.progress.begun = True
    _steps(begun, steps, told)
    save_checkpoint(begun, path)
    found = list[Sequence[float]]()
    for solved in (False, True):
        state = load_state(context, path)
        if solved:
            state.exposures = Exposures.identity(context.scene.train, context.renderer.device)
        _steps(state, steps, told)
        found.append([_psnr(state, view) for view in context.scene.test])
    return Fork(tuple(found[0]), tuple(found[1]))


def _steps(state: TrainState, steps: int, told: Callable[[], None]) -> None:
    state.observer = Silent()
    phase = phases_of(state.context.config)[0]
    set_optimizer(state, phase.make_optimizer(state))
    for _ in range(steps):
        phase.step(state)
        state.progress.step += 1
        told()
    sync_losses(state)


def _psnr(state: TrainState, view: int) -> float:
    """Plain PSNR of the finest level on one photo, where its mask counts, dB."""
    context, scale = state.context, state.context.config.scale
    camera, target = context.scene.camera(view, scale), load_target(state, view, scale)
    with torch.no_grad():
        drawn = context.renderer.render(
            state.model.decode(camera), camera, background_of(state, view)
        )
        image, share = compare(state, drawn.image, target, view, scale)
        error = mean_squared_error(image, target) / share
    return float(-10 * error.clamp(min=1e-10).log10())
