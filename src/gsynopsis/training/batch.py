"""Gradients of a view as one flat tensor, so that views and processes add up in one order."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


def take_gradients(parameters: Sequence[nn.Parameter]) -> list[Tensor]:
    """The gradient of each parameter, flat, zeros where there is none; gradients are dropped."""
    gradients = [
        p.new_zeros(p.numel()) if p.grad is None else p.grad.reshape(-1) for p in parameters
    ]
    for parameter in parameters:
        parameter.grad = None
    return gradients


def pack_gradients(parameters: Sequence[nn.Parameter], shown: Tensor) -> Tensor:
    """All gradients, which of them there are, and the losses, float32 [S]; gradients are dropped.

    Args:
        parameters: Float32, in an order that every process knows.
        shown: Loss and squared error of each image, [B, P, 2], zero where others work.
    """
    there = torch.tensor([p.grad is not None for p in parameters], dtype=torch.float32)
    tail = torch.cat([there, shown.reshape(-1)]).to(parameters[0].device)
    return torch.cat([*take_gradients(parameters), tail])


def unpack_gradients(total: Tensor, parameters: Sequence[nn.Parameter], count: int) -> Tensor:
    """Give each parameter its mean gradient over `count` views; the inverse of `pack_gradients`.

    A parameter that had no gradient in any view gets none.

    Returns:
        Loss and squared error of every image, float32 [B·P, 2] on the CPU, in order of views.
    """
    sizes = [p.numel() for p in parameters]
    *pieces, tail = total.split([*sizes, len(total) - sum(sizes)])
    tail = tail.cpu()
    for parameter, piece, there in zip(parameters, pieces, tail.tolist(), strict=False):
        parameter.grad = (piece / count).view_as(parameter) if there else None
    return tail[len(parameters) :].view(-1, 2)
