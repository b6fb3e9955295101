"""Parts of coarser levels: their start from the next finer one, and weights that levels share."""

from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.heads import without_columns


def coarser_part(model: AnchorModel, parent: LevelPart, mask: Tensor, grids: int) -> LevelPart:
    """A coarser level's start: the parent's weights without the columns of dropped grids.

    Deleting a column is the same as feeding it zeros (methods.md §1.5).
    """
    width = model.layout.features
    networks = without_columns(dict(parent.networks.items()), grids * width, parent.grids * width)
    part = LevelPart(mask, grids, parent.codebook.detach().clone(), networks)
    part.log_gain.data.copy_(parent.log_gain.data)
    return part


def tie_weights(model: AnchorModel) -> None:
    """Give all levels the matrices of the finest, the same parameters; biases stay (ours)."""
    *coarser, finest = model.level_parts()
    for part in coarser:
        for name, weight in finest.networks.items():
            if weight.ndim == 2:
                part.networks[name] = weight
