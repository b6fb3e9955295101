"""Losses of a training: pending on the device, then read together, smoothed and checked."""

import numpy as np
import torch
from torch import Tensor

from gsynopsis.errors import DivergedError, PeerError
from gsynopsis.training.state import PendingLoss, Progress, TrainState

SMOOTHING = 0.98
"""Weight of the past in the loss and PSNR on display, about 50 steps."""


def log_view(state: TrainState, view: int, loss: Tensor, error: Tensor) -> None:
    """Keep loss and squared error of one image, float64 []; checked when they are read.

    Raises:
        DivergedError: the loss is not finite, where losses are read in each step.
    """
    losses, value = state.losses, torch.stack([loss, error])
    if state.context.config.train.batch == 1:
        log_step(state, (view,), value[None])
        return
    losses.of_view.append(value)
    if losses.read_every == 1 and not bool(torch.isfinite(loss)):
        # The other processes wait for this step's sum: it tells them.
        losses.failures.append(_diverged(state, state.progress.step + 1, view, float(loss)))


def log_step(state: TrainState, views: tuple[int, ...], values: Tensor) -> None:
    """Keep losses and errors [P, 2] of a step; read them where it is time, and the first at once.

    Raises:
        DivergedError: see `sync_losses`.
        PeerError: likewise.
    """
    losses, step = state.losses, state.progress.step + 1
    losses.pending.append(PendingLoss(step, views, values))
    due = step - losses.pending[0].step >= losses.read_every - 1
    if due or state.progress.loss == 0:
        sync_losses(state)


def sync_losses(state: TrainState) -> None:
    """Read all pending losses at once and smooth them into the progress.

    Raises:
        DivergedError: one is not finite.
        PeerError: a view of another process diverged.
    """
    pending, state.losses.pending = state.losses.pending, []
    if not pending:
        return
    if state.passes.whole is not None:
        state.passes.whole.settle()
    values = torch.cat([one.values for one in pending]).tolist()
    labels = [(one, place) for one in pending for place in range(len(one.views))]
    for (one, place), (value, error) in zip(labels, values, strict=True):
        if not np.isfinite(value):
            if place not in state.context.group.shard(range(len(one.views))):
                raise PeerError("another process of this training diverged; see its message")
            raise _diverged(state, one.step, one.views[place], value)
        _smooth(state.progress, value, error)


def non_finite(state: TrainState) -> str:
    """Name of the first parameter with a value that is not finite; empty if all are."""
    state.passes.home()
    for name, parameter in state.model.named_parameters():
        if not bool(torch.isfinite(parameter).all()):
            return name
    return ""


def _smooth(progress: Progress, value: float, error: float) -> None:
    keep = 0.0 if progress.loss == 0 else SMOOTHING
    progress.loss = keep * progress.loss + (1 - keep) * value
    progress.error = keep * progress.error + (1 - keep) * error


def _diverged(state: TrainState, step: int, view: int, value: float) -> DivergedError:
    return DivergedError(
        f"step {step}: view {state.context.scene.views[view].name} gives a loss of {value} or "
        f"opacities that are not all finite; first non-finite tensor: "
        f"{non_finite(state) or 'none'}; the last checkpoint is kept"
    )
