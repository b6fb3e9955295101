"""Gradients of a view as one flat tensor, so that views and processes add up in one order."""

from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn

from gsynopsis.render.base import sent
from gsynopsis.training.distributed.process_group import ProcessGroup, pairwise_sum
from gsynopsis.training.loss_log import log_step, sync_losses
from gsynopsis.training.state import TrainState

TABLE_ROWS = 64
"""Parameters of fewer rows are exchanged whole."""


def synced_views(state: TrainState, views: Sequence[int]) -> Iterator[int]:
    """This process's share of a step's views; train each before asking for the next.

    At the end the gradient of every parameter is the mean over all views of all processes, and it
    is the same, bit for bit, for one process and for two.

    Raises:
        DivergedError: a loss is not finite.
        PeerError: another process stopped.
    """
    if len(views) == 1:
        yield views[0]
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


def sum_over_views(
    state: TrainState,
    what: str,
    views: Sequence[int],
    size: int,
    add: Callable[[int, Tensor], None],
) -> Tensor:
    """A float32 [size] tensor that every view of all processes adds to.

    Summed as gradients are, each place of the batch its own views and then the places: so it is
    the same, bit for bit, for one process and for two.

    Args:
        state: Its observer hears of each view.
        what: The work, for people.
        views: Indices into the scene's views.
        size: Length of the tensor.
        add: Adds a view's share to the tensor it is given.
    """
    batch, group = state.context.config.train.batch, state.context.group
    sync_losses(state)
    shares = [views[place::batch] for place in group.shard(range(batch))]
    done, count, totals = 0, sum(map(len, shares)), list[Tensor]()
    for share in shares:
        total = torch.zeros(size, device=state.context.renderer.device)
        for view in share:
            add(view, total)
            done += 1
            state.observer.on_pass(what, done, count)
        totals.append(total)
    return group.sum(pairwise_sum(totals))


def take_gradients(parameters: Sequence[nn.Parameter]) -> list[Tensor]:
    """The gradient of each parameter, flat, zeros where there is none; gradients are dropped."""
    gradients = [
        p.new_zeros(p.numel()) if p.grad is None else p.grad.reshape(-1) for p in parameters
    ]
    for parameter in parameters:
        parameter.grad = None
    return gradients


def gradients_there(parameters: Sequence[nn.Parameter]) -> list[bool]:
    """Mask of the parameters that have a gradient."""
    return [parameter.grad is not None for parameter in parameters]


def pack_gradients(parameters: Sequence[nn.Parameter], shown: Tensor) -> Tensor:
    """All gradients, which of them there are, and the losses, float32 [S]; gradients are dropped.

    Args:
        parameters: Float32, in an order that every process knows.
        shown: Loss and squared error of each image, [B, P, 2], zero where others work.
    """
    there = torch.tensor(gradients_there(parameters), dtype=torch.float32)
    return torch.cat(
        [*take_gradients(parameters), sent(there, shown.device), shown.float().reshape(-1)]
    )


def sum_gradients(
    group: ProcessGroup, packed: Tensor, parameters: Sequence[nn.Parameter]
) -> Tensor:
    """Packed gradients summed over all processes, in place; the bits of `group.sum`.

    A view sees some of the anchors and reads some of the grids' rows. Of tables only the rows are
    exchanged that have a gradient in some process; the others are zeros in all of them.

    Raises:
        PeerError: another process is gone.
    """
    sizes = [p.numel() for p in parameters]
    pieces = packed.split([*sizes, len(packed) - sum(sizes)])
    is_table = [p.dim() > 1 and len(p) >= TABLE_ROWS and p.numel() > 0 for p in parameters]
    if group.size == 1 or not any(is_table):
        return group.sum(packed)
    shaped = zip(parameters, pieces, is_table, strict=False)
    tables = [piece.view(len(p), -1) for p, piece, table in shaped if table]
    whole = [piece for piece, table in zip(pieces, [*is_table, False], strict=True) if not table]
    # Bits, not values: a zero with a sign would stay in one process and not in the other.
    changed = torch.cat([(t.view(torch.int32) != 0).any(dim=1) for t in tables]).byte()
    masks = group.max(changed).bool().split([len(t) for t in tables])
    rows = [mask.nonzero()[:, 0] for mask in masks]
    some = [t.index_select(0, r).flatten() for t, r in zip(tables, rows, strict=True)]
    total = group.sum(torch.cat([*some, *whole]))
    found = total.split([len(part) for part in (*some, *whole)])
    for table, row, part in zip(tables, rows, found, strict=False):
        table.index_copy_(0, row, part.view(len(row), table.shape[1]))
    for piece, part in zip(whole, found[len(tables) :], strict=True):
        piece.copy_(part)
    return packed


def unpack_gradients(
    total: Tensor, parameters: Sequence[nn.Parameter], count: int, there: Sequence[bool] | None
) -> Tensor:
    """Give each parameter its mean gradient over `count` views; the inverse of `pack_gradients`.

    A parameter that had no gradient in any view gets none.

    Args:
        total: The sum of packed gradients.
        parameters: As they were packed.
        count: Views.
        there: Which parameters had a gradient in any view. Where only all processes together know,
            None: it is read from the sum, for which the host has to wait.

    Returns:
        Loss and squared error of every image, float32 [B·P, 2], in order of views.
    """
    sizes = [p.numel() for p in parameters]
    *pieces, flags, shown = total.split([*sizes, len(sizes), len(total) - sum(sizes) - len(sizes)])
    found = flags.tolist() if there is None else there
    for parameter, piece, has in zip(parameters, pieces, found, strict=True):
        parameter.grad = (piece / count).view_as(parameter) if has else None
    return shown.view(-1, 2)
