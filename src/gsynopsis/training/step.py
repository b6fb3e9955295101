"""The frame of a step: pick views, add up their gradients, move the parameters, keep the losses.

for view in synced_views(state, next_views(state)):
    train_view(state, part, view, factor)  # view_step.py
state.optimizer.set_progress(progress)
optimizer_step(state)
"""

from collections.abc import Iterator, Sequence
from math import isqrt

import numpy as np
import torch
from torch import Tensor

from gsynopsis.errors import DivergedError, PeerError
from gsynopsis.model.anchors import ROW_PARAMETERS
from gsynopsis.scene.camera import Shift
from gsynopsis.training.distributed.gradient_sync import (
    gradients_there,
    pack_gradients,
    sum_gradients,
    unpack_gradients,
)
from gsynopsis.training.distributed.process_group import pairwise_sum
from gsynopsis.training.state import PendingLoss, Progress, TrainState, bring_home

SMOOTHING = 0.98
"""Weight of the past in the loss and PSNR on display, about 50 steps."""


def next_views(state: TrainState) -> list[int]:
    """The `train.batch` views of a step; draws their jitter. Alike in every process."""
    if len(state.shifts) > 1:
        state.jitter = draw_jitter(state.rng, state.shifts)
    return [next_view(state) for _ in range(state.context.config.train.batch)]


def next_view(state: TrainState) -> int:
    """A training view, without replacement until all were seen (methods.md §1.7)."""
    context, progress = state.context, state.progress
    train = context.scene.train
    if not progress.order:
        progress.order = [train[i] for i in state.rng.permutation(len(train))]
    view = progress.order.pop()
    if progress.order:
        # Decode, or upload, the photo of the next step while this one computes.
        loader = context.scene if state.photos is None else state.photos
        loader.expect(progress.order[-1], state.factor, state.shifts)
    return view


def reduced_factor(state: TrainState, progress: float) -> float:
    """Division of this step's photos at a share of all steps, see `TrainConfig.reduced_until`.

    A block goes on from the whole, which has seen the small pictures.
    """
    config, region = state.context.config, state.context.region
    halvings = sum(progress < share for share in config.train.reduced_until)
    return config.scale * 2.0**halvings if region is None else config.scale


def draw_jitter(rng: np.random.Generator, shifts: Sequence[Shift]) -> Shift:
    """One of the places of a pixel that `shift_places` gives, all as likely."""
    along = isqrt(len(shifts))
    right, down = rng.integers(along, size=2).tolist()
    return shifts[right * along + down]


def synced_views(state: TrainState, views: Sequence[int]) -> Iterator[int]:
    """This process's share of a step's views; train each before asking for the next.

    At the end the gradient of every parameter is the mean over all views of all processes, and it
    is the same, bit for bit, for one process and for two. A device of whole steps has their sum,
    which `optimizer_step` divides; their losses are logged one by one.

    Raises:
        DivergedError: a loss is not finite.
        PeerError: another process stopped.
    """
    if len(views) == 1 or state.whole is not None:
        yield from views
        return
    group, device, losses = state.context.group, state.context.renderer.device, state.losses
    parameters, own, buffers = state.optimizer.parameters(), group.shard(views), list[Tensor]()
    there = [False] * len(parameters)
    for place, view in enumerate(own):
        losses.of_view = []
        yield view
        logged = torch.zeros(len(views), len(losses.of_view), 2, device=device)
        logged[group.rank * len(own) + place] = torch.stack(losses.of_view)
        there = [a or b for a, b in zip(there, gradients_there(parameters), strict=True)]
        buffers.append(pack_gradients(parameters, logged))
    total = sum_gradients(group, pairwise_sum(buffers), parameters)
    # With one process the host knows which gradients there are, and need not ask the device.
    known = there if group.size == 1 else None
    logged = unpack_gradients(total, parameters, len(views), known)
    if losses.failures:
        raise losses.failures[0]
    each = len(logged) // len(views)
    log_step(state, tuple(view for view in views for _ in range(each)), logged)


def optimizer_step(state: TrainState) -> None:
    """Move the trainable anchors by their gradients, which are dropped."""
    trainable = trainable_anchors(state)
    if trainable is not None:
        # Adam leaves in place, to the bit, what never had a gradient.
        for name in ROW_PARAMETERS:
            grad = getattr(state.model, name).grad
            if grad is not None:
                grad[~trainable] = 0
    if state.whole is not None:
        state.whole.move(state.optimizer, state.context.config.train.batch)
    else:
        state.optimizer.step()


def trainable_anchors(state: TrainState) -> Tensor | None:
    """Anchors inside the trained region, bool [N]; None: all of them."""
    region = state.context.region
    return None if region is None else region.holds(state.model.placed()[0])


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
    if state.whole is not None:
        state.whole.settle()
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
    bring_home(state)
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
