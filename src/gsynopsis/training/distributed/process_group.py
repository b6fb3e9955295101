"""Several processes that train one model, each on its own views, by torch.distributed.

Every process holds the whole model and draws the same random numbers; gradients and statistics
are summed between them, so that all of them take the same steps. One process is the default and
needs none of this. `torchrun` starts the others and tells each its rank.
"""

import os
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TypeVar

import torch
from torch import Tensor, distributed

from gsynopsis.errors import GsynopsisError, PeerError, SettingError

T = TypeVar("T")
TORCHRUN = "unset WORLD_SIZE, or start with torchrun"


@dataclass(frozen=True)
class ProcessGroup:
    """This process among all that train together.

    With one process nothing is sent and every method gives back what it was given. With several,
    each method has to be called by all of them, in the same order.

    Attributes:
        rank: Number of this process, from 0; process 0 alone writes files and progress.
        size: Number of processes.
    """

    rank: int = 0
    size: int = 1

    @property
    def is_main(self) -> bool:
        """True for the process that writes and prints."""
        return self.rank == 0

    def shard(self, items: Sequence[int]) -> Sequence[int]:
        """This process's block of items that are worked on in parallel; blocks are equally long."""
        length = len(items) // self.size
        return items[self.rank * length : (self.rank + 1) * length]

    def sum(self, tensor: Tensor) -> Tensor:
        """The sum over all processes, in place; the same bits on each of them.

        Two terms give the same bits in either order; the sum of more depends on the number of
        processes in its last bits.

        Raises:
            PeerError: another process is gone.
        """
        if self.size > 1:
            _with_peers(distributed.all_reduce, tensor)
        return tensor

    def max(self, tensor: Tensor) -> Tensor:
        """The largest value of all processes at each place, in place.

        Raises:
            PeerError: another process is gone.
        """
        if self.size > 1:
            _with_peers(distributed.all_reduce, tensor, distributed.ReduceOp.MAX)
        return tensor

    def any(self, *flags: bool) -> tuple[bool, ...]:
        """For each flag whether any process raised it.

        Raises:
            PeerError: another process is gone.
        """
        if self.size == 1:
            return flags
        raised = torch.tensor(flags, dtype=torch.int32)
        _with_peers(distributed.all_reduce, raised, distributed.ReduceOp.MAX)
        return tuple(bool(flag) for flag in raised)

    def gather(self, tensor: Tensor) -> Tensor:
        """Equal blocks of rows of all processes under each other, in the order of ranks.

        Raises:
            PeerError: another process is gone.
        """
        if self.size == 1:
            return tensor
        blocks = [torch.empty_like(tensor) for _ in range(self.size)]
        _with_peers(distributed.all_gather, blocks, tensor.contiguous())
        return torch.cat(blocks)

    def on_main(self, action: Callable[[], T]) -> T | None:
        """Let process 0 do a thing once, such as writing a file; the others wait.

        Returns:
            The result, in process 0; None in the others.

        Raises:
            PeerError: it failed in process 0, which raises its own error.
        """
        if self.size == 1:
            return action()
        error: Exception | None = None
        result: T | None = None
        if self.is_main:
            try:
                result = action()
            except (GsynopsisError, OSError) as caught:
                error = caught
        (failed,) = self.any(error is not None)
        if error is not None:
            raise error
        if failed:
            raise PeerError("the first process of this training stopped")
        return result


@contextmanager
def init_process_group(environment: Mapping[str, str] = os.environ) -> Generator[ProcessGroup]:
    """The world that torchrun's environment describes, for one `with` block; one without it.

    In all processes but the first, `PeerError` and Ctrl-C end the block without a word: the
    first process reports them.

    Args:
        environment: WORLD_SIZE, RANK, LOCAL_RANK and the meeting point, as torchrun sets them.

    Raises:
        PeerError: the others cannot be reached.
        SettingError: there are fewer GPUs than processes.
    """
    if world_size(environment) == 1:
        yield ProcessGroup()
        return
    backends = "cpu:gloo"
    if torch.cuda.is_available():  # each process takes its own GPU
        place, count = _number(environment, "LOCAL_RANK", 0), torch.cuda.device_count()
        if place >= count:
            expected = f"at most the {count} GPUs of this machine"
            raise SettingError("--nproc-per-node", found=f"over {place}", expected=expected)
        torch.cuda.set_device(place)
        backends += ",cuda:nccl"
    # Has the group as default of its arguments, and would keep its threads beyond the end if
    # it were imported later, as torch's optimisers do; the interpreter's end may then abort.
    import_module("torch.distributed.nn")
    try:
        _with_peers(distributed.init_process_group, backends)
    except ValueError as error:  # torchrun sets all that it wants, a shell perhaps some
        expected = "what torchrun sets"
        raise SettingError("torchrun", found=error, expected=expected, advice=TORCHRUN) from error
    group = ProcessGroup(distributed.get_rank(), distributed.get_world_size())
    try:
        yield group
    except (PeerError, KeyboardInterrupt):
        if group.is_main:
            raise
    finally:
        distributed.destroy_process_group()


def world_size(environment: Mapping[str, str] = os.environ) -> int:
    """Number of processes that train together.

    Raises:
        SettingError: WORLD_SIZE is no such number.
    """
    return _number(environment, "WORLD_SIZE", 1)


def _number(environment: Mapping[str, str], name: str, least: int) -> int:
    text = environment.get(name, str(least))
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) >= least):
        expected = f"a whole number from {least} on"
        raise SettingError(name, found=text, expected=expected, advice=TORCHRUN)
    return int(text)


def pairwise_sum(tensors: Sequence[Tensor]) -> Tensor:
    """The sum of tensors as a balanced tree: what processes with equal blocks would add up.

    Where the number of processes is a power of two, each process's partial sum is a branch.
    """
    if len(tensors) == 1:
        return tensors[0]
    middle = len(tensors) // 2
    return pairwise_sum(tensors[:middle]) + pairwise_sum(tensors[middle:])


def _with_peers(collective: Callable[..., object], *arguments: object) -> None:
    """Call it; torch.distributed reports a lost connection as a bare RuntimeError."""
    try:
        collective(*arguments)
        return
    except RuntimeError as error:
        reason = str(error).strip().split("\n")[0]
    # Raised out here, the error holds no frame of torch's. They hold the broken group: kept, they
    # would let its threads outlive `destroy_process_group`, and the interpreter's end then aborts.
    raise PeerError(f"another process of this training is gone ({reason})")
