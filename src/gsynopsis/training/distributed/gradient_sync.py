"""Gradients of a view as one flat tensor, so that views and processes add up in one order."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from gsynopsis.render.base import sent
from gsynopsis.training.distributed.process_group import ProcessGroup

TABLE_ROWS = 64
"""Parameters of fewer rows are exchanged whole."""


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
