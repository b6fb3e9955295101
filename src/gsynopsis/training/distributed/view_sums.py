"""Sums over many views of what each adds, the same for one process and for several."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from gsynopsis.training.distributed.process_group import pairwise_sum
from gsynopsis.training.state import TrainState
from gsynopsis.training.step import sync_losses


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
