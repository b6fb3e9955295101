"""A model whose regions stand at different levels, and fading from one such model to the next.

What appears with new data fades in, and what the new networks and codebook change is interpolated
(methods.md §5.5), so that no image of a smooth flight differs much from the one before.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gsynopsis.model.splats import decoder_of
from gsynopsis.records import MORTON_BITS, LevelSet, morton_codes
from gsynopsis.render.base import Gaussians
from gsynopsis.scene.camera import Camera

FADE_FRAMES = 12
"""Frames over which a change is spread: 0.4 s at 30 frames per second (ours)."""


@dataclass(frozen=True)
class KeyedGaussians:
    """Gaussians with names that mean the same in every state of a file.

    Attributes:
        cells: Morton code of the anchor's cell, int64 [G], ascending.
        slots: Slot of the anchor, int64 [G], ascending within a cell.
        gaussians: In the order of the names.
    """

    cells: Tensor
    slots: Tensor
    gaussians: Gaussians


class MultiLevelModel:
    """Each anchor is rendered with the networks, codebook, grids and mask of its region's level.

    Were levels trained on photos of different sizes, the size of the coarsest that is there counts.
    """

    def __init__(self, levels: LevelSet, region: NDArray[np.uint8], device: torch.device) -> None:
        """Build it on a device.

        Args:
            levels: All levels that any region has.
            region: Level of each anchor of the last one, uint8 [N].
            device: The renderer's.
        """
        self._model = decoder_of(levels).to(device)
        where = torch.from_numpy(region.astype(np.int64)).to(device)
        for number in range(len(levels.levels)):
            part = self._model.part(number)
            part.mask = part.mask & (where == number)[:, None]
        lowest = 1 << (MORTON_BITS - 1)
        codes = morton_codes((levels.shared.lattice.astype(np.int64) + lowest).astype(np.uint64))
        self._cells = torch.from_numpy(codes.astype(np.int64)).to(device)

    def decode(self, camera: Camera, level: int = -1) -> Gaussians:
        """The Gaussians a camera sees; `level` is ignored, regions have theirs."""
        return self.named(camera).gaussians

    def named(self, camera: Camera) -> KeyedGaussians:
        """The Gaussians a camera sees, with names."""
        slots = self._model.slots
        cells: list[Tensor] = []
        within: list[Tensor] = []
        pieces: list[Gaussians] = []
        with torch.no_grad():
            for number in range(len(self._model.parts)):
                part = self._model.part(number)
                if not bool(part.mask.any()):
                    continue
                decoded = self._model.decode_level(number, camera)
                cells.append(self._cells[decoded.slots // slots])
                within.append(decoded.slots % slots)
                pieces.append(decoded.gaussians)
        joined = _joined(pieces)
        cell, slot = torch.cat(cells), torch.cat(within)
        order = torch.argsort(slot)
        order = order[torch.sort(cell[order], stable=True).indices]
        return KeyedGaussians(cell[order], slot[order], _chosen(joined, order))


def cross_fade(before: KeyedGaussians, after: KeyedGaussians, weight: float) -> Gaussians:
    """An image between two states of the same view.

    Gaussians of both move, turn and change colour from one to the other; those of one only fade
    in or out.

    Args:
        before: The old state.
        after: The new state.
        weight: 0: the old, 1: the new.
    """
    if weight <= 0 or weight >= 1:
        return after.gaussians if weight >= 1 else before.gaussians
    old, new = before.gaussians, after.gaussians
    old_names, new_names = _common_keys(before, after)
    at = torch.searchsorted(old_names, new_names).clamp(max=max(0, len(old_names) - 1))
    both = (
        old_names[at] == new_names
        if len(old_names)
        else torch.zeros_like(new_names, dtype=torch.bool)
    )
    gone = torch.ones(len(old_names), dtype=torch.bool, device=new_names.device)
    gone[at[both]] = False
    kept = _between(_chosen(old, at[both]), _chosen(new, both.nonzero()[:, 0]), weight)
    fresh = _chosen(new, (~both).nonzero()[:, 0])
    left = _chosen(old, gone.nonzero()[:, 0])
    return _joined([kept, _dimmed(fresh, weight), _dimmed(left, 1 - weight)])


def _common_keys(before: KeyedGaussians, after: KeyedGaussians) -> tuple[Tensor, Tensor]:
    """Ascending int64 keys of the Gaussians of two states, equal where cell and slot are.

    A cell's code takes 63 bits, so cells are numbered first.
    """
    both = torch.cat([before.cells, after.cells])
    numbers = torch.unique(both, return_inverse=True)[1]
    slots = torch.cat([before.slots, after.slots])
    names = numbers * (int(slots.max()) + 1 if len(slots) else 1) + slots
    return names[: len(before.cells)], names[len(before.cells) :]


def _between(old: Gaussians, new: Gaussians, weight: float) -> Gaussians:
    """The same Gaussians on their way; rotations take the shorter way round."""
    same = (old.quats * new.quats).sum(dim=1, keepdim=True) >= 0
    quats = torch.lerp(torch.where(same, old.quats, -old.quats), new.quats, weight)
    return Gaussians(
        torch.lerp(old.means, new.means, weight),
        functional.normalize(quats, dim=1),
        torch.lerp(old.scales.log(), new.scales.log(), weight).exp(),
        torch.lerp(old.opacities, new.opacities, weight),
        torch.lerp(old.colors, new.colors, weight),
        focals=new.focals,
    )


def _dimmed(gaussians: Gaussians, weight: float) -> Gaussians:
    return replace(gaussians, opacities=gaussians.opacities * weight)


def _chosen(gaussians: Gaussians, rows: Tensor) -> Gaussians:
    g = gaussians
    shape = (g.means[rows], g.quats[rows], g.scales[rows])
    return Gaussians(*shape, g.opacities[rows], g.colors[rows], focals=g.focals)


def _joined(pieces: list[Gaussians]) -> Gaussians:
    return Gaussians(
        torch.cat([g.means for g in pieces]),
        torch.cat([g.quats for g in pieces]),
        torch.cat([g.scales for g in pieces]),
        torch.cat([g.opacities for g in pieces]),
        torch.cat([g.colors for g in pieces]),
        focals=pieces[0].focals,
    )
