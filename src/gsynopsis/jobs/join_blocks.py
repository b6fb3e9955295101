"""Trained blocks as one training of the whole scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.plan_blocks import BLOCKS, SpaceBlock
from gsynopsis.jobs.train_block import block_context, seeded_state
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel
from gsynopsis.model.build import select_anchors
from gsynopsis.training.checkpoint import load_state, save_checkpoint
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import CHECKPOINT, phases_of
from gsynopsis.training.state import Progress, TrainState


@dataclass(frozen=True)
class FromBlocks:
    """Trained blocks, joined into one model at the last step of the run.

    Attributes:
        whole: The trained whole; its model is taken.
        blocks: All blocks; one without photos is as the whole has it.
        options: Options that the blocks were trained with.
    """

    whole: TrainState
    blocks: tuple[SpaceBlock, ...]
    options: RunOptions

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        joined = join_blocks(context, self.whole, self.blocks, out, self.options)
        save_checkpoint(joined, out / CHECKPOINT)
        return f"joined {len(self.blocks)} blocks: {len(joined.model):,} anchors"


@dataclass(frozen=True)
class Joined:
    """Blocks that were joined before: the folder's own checkpoint."""

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        return ""


@one_torch_thread()
def join_blocks(
    context: TrainContext,
    whole: TrainState,
    blocks: Sequence[SpaceBlock],
    run: Path,
    options: RunOptions,
) -> TrainState:
    """One training out of all blocks: of each what is its own; at its last step.

    Args:
        context: Of the run.
        whole: The trained whole; its model is taken.
        blocks: All of them; one without photos is as the whole has it.
        run: Folder of the run.
        options: As the blocks were trained.
    """
    models: list[AnchorModel] = []
    seconds = whole.progress.seconds
    for block in blocks:
        state = whole
        if block.views:
            of_block = block_context(context.scene, context.config, options, block)
            state = load_state(of_block, run / BLOCKS / block.folder / CHECKPOINT)
            seconds += state.progress.seconds
        models.append(select_anchors(state.model, block.own.holds(state.model.placed()[0])))
    model = whole.model
    with torch.no_grad():
        model.set_lattice(torch.cat([m.lattice for m in models]))
        for name in ROW_PARAMETERS:
            rows = torch.cat([getattr(m, name) for m in models])
            setattr(model, name, torch.nn.Parameter(rows))
        for level, part in enumerate(model.level_parts()):
            part.mask = torch.cat([m.part(level).mask for m in models])
    phases, joined = phases_of(context.config), seeded_state(context, model)
    joined.exposures = whole.exposures
    last = len(phases) - 1
    joined.progress = Progress(phase=last, begun=True, step=phases[last].steps, seconds=seconds)
    joined.progress.phase_seconds = {phase.name: 0.0 for phase in phases[:-1]}
    return joined
