"""What processes exchange: the bits of the whole sum, and no rows that are zeros everywhere."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import reduce
from threading import Barrier

import pytest
import torch
from torch import Tensor, nn

from gsynopsis.training.distributed.gradient_sync import (
    pack_gradients,
    sum_gradients,
    unpack_gradients,
)
from gsynopsis.training.distributed.process_group import ProcessGroup
from tests.devices import DEVICES


@dataclass
class Wire:
    """Between processes that are threads here."""

    size: int
    tensors: dict[int, Tensor] = field(default_factory=dict)
    values: int = 0

    def __post_init__(self) -> None:
        self.barrier = Barrier(self.size, timeout=60)

    def reduced(self, rank: int, tensor: Tensor, how: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
        self.tensors[rank] = tensor.clone()
        self.barrier.wait()
        tensor.copy_(reduce(how, (self.tensors[r] for r in range(self.size))))
        if rank == 0 and tensor.dtype == torch.float32:
            self.values += tensor.numel()
        self.barrier.wait()
        return tensor


@dataclass(frozen=True)
class Peer(ProcessGroup):
    wire: Wire = field(default_factory=lambda: Wire(1))

    def sum(self, tensor: Tensor) -> Tensor:
        return self.wire.reduced(self.rank, tensor, torch.add)

    def max(self, tensor: Tensor) -> Tensor:
        return self.wire.reduced(self.rank, tensor, torch.maximum)


SHAPES = [(500, 3, 3), (200, 4), (70, 0), (5, 300), (64,)]
"""Two tables, an empty one, a wide matrix of few rows, a vector."""


def packed(rank: int, device: str) -> tuple[list[nn.Parameter], Tensor]:
    """Gradients of a process: some rows, some of them shared, zeros with and without a sign."""
    generator = torch.Generator().manual_seed(rank)
    parameters = [nn.Parameter(torch.zeros(shape, device=device)) for shape in SHAPES]
    for parameter in parameters[: len(SHAPES) - rank]:  # the last one of process 0 alone
        grad = torch.randn(parameter.shape, generator=generator)
        if len(parameter) >= 100:
            grad[torch.rand(len(parameter), generator=generator) > 0.1] = 0
            grad[:20] = -0.0
        parameter.grad = grad.to(device)
    return parameters, pack_gradients(parameters, torch.zeros(2, 1, 2, device=device))


def exchanged(size: int, device: str) -> tuple[list[Tensor], int]:
    wire = Wire(size)

    def process(rank: int) -> Tensor:
        parameters, own = packed(rank, device)
        return sum_gradients(Peer(rank, size, wire), own, parameters)

    with ThreadPoolExecutor(size) as pool:
        return list(pool.map(process, range(size))), wire.values


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("size", [2, 3])
def test_all_processes_have_the_bits_of_the_whole_sum(size: int, device: str) -> None:
    expected = reduce(torch.add, (packed(rank, device)[1] for rank in range(size)))
    found, values = exchanged(size, device)
    for total in found:
        assert torch.equal(total.view(torch.int32), expected.view(torch.int32))
    assert values < 0.7 * len(expected)


def test_what_comes_back_is_the_mean_of_those_that_have_a_gradient() -> None:
    found, _ = exchanged(2, "cpu")
    parameters, _ = packed(0, "cpu")
    unpack_gradients(found[0], parameters, 2, None)
    grads = [[p.grad for p in own] for own in (with_gradients(0), with_gradients(1))]
    for parameter, one, two in zip(parameters, *grads, strict=True):
        assert one is not None and parameter.grad is not None
        assert torch.allclose(parameter.grad, (one if two is None else one + two) / 2)


def with_gradients(rank: int) -> list[nn.Parameter]:
    """The parameters of `packed`, which drops their gradients, with them."""
    parameters, flat = packed(rank, "cpu")
    unpack_gradients(flat, parameters, 1, None)
    return parameters


def test_one_process_exchanges_nothing() -> None:
    parameters, own = packed(0, "cpu")
    assert sum_gradients(ProcessGroup(), own, parameters) is own
