"""Gradients of a view as one flat tensor, so that views and processes add up in one order."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from gsynopsis.render.base import sent


def take_gradients(parameters: Sequence[nn.Parameter]) -> list[Tensor]:
    """The gradient of each parameter, flat, zeros where there is none; gradients are dropped."""
    gradients = [
        p.new_zeros(p.numel()) if p.grad is None else p.grad.reshape(-1) for p in parameters
    ]
    for parameter in parameters:
        parameter.grad = None
    return gradients


def gradients_there(parameters: Sequence[nn.Parameter]) -> list[bool]:
    """Which parameters have a gradient."""
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
