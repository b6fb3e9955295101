"""Growing and pruning of anchors: statistics, candidates, new rows (methods.md §1.9)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from gsynopsis.config import Config, GrowthConfig
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel
from gsynopsis.model.lattice import KEY_LIMIT, free_cells, growth_cells
from gsynopsis.model.tables import Decoded
from gsynopsis.render.base import sent
from gsynopsis.scene.scene import Scene
from gsynopsis.training.distributed.process_group import ProcessGroup, pairwise_sum
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.sub_scene import Region

STATISTICS_FROM, ADJUST_FROM = 1 / 60, 1 / 20
"""Shares of the full training's steps after which statistics are collected, and used."""
PRUNE_OPACITY = 0.005
"""An anchor is pruned if its summed positive opacity per visit is below this."""
LEVELS = 3
"""Growth levels, with cells of `cell`, /4, /16 voxels."""


def growth_limit(scene: Scene, config: Config, still: int = 0) -> int:
    """Anchors beyond which nothing grows: `max_anchors`, or fewer where images are small.

    Args:
        scene: Whose images.
        config: Settings.
        still: Anchors that are not moved and do not count against the size of images.
    """
    growth = config.train.growth
    if not growth.per_pixel:
        return growth.max_anchors
    cameras = (scene.camera(view, config.scale) for view in scene.train)
    pixels = max(camera.width * camera.height for camera in cameras)
    return min(growth.max_anchors, still + math.ceil(growth.per_pixel * pixels))


@dataclass
class GrowthStatistics:
    """Counters between adjustments, per slot or per anchor."""

    gradient: Tensor  # [N·K] summed norm of the projected centre's gradient, NDC units
    drawn: Tensor  # [N·K] how often the slot was rendered
    opacity: Tensor  # [N] summed positive opacity
    visits: Tensor  # [N] how often the anchor was in view

    @staticmethod
    def zeros(anchors: int, slots: int, device: torch.device) -> "GrowthStatistics":
        """Nothing counted yet."""
        sizes = (anchors * slots, anchors * slots, anchors, anchors)
        return GrowthStatistics(*(torch.zeros(n, device=device) for n in sizes))

    def tensors(self) -> dict[str, Tensor]:
        """All counters by name, for a checkpoint."""
        return dict(vars(self))

    def emptied(self) -> "GrowthStatistics":
        """Counters of the same shapes, all zero."""
        return GrowthStatistics(*(torch.zeros_like(t) for t in self.tensors().values()))

    def count(
        self, decoded: Decoded, screen_grad: Tensor, visible: Tensor, size: tuple[int, int]
    ) -> None:
        """Count one view in PyTorch, on any device; `view_step.count_view` has the native one.

        Args:
            decoded: What was rendered.
            screen_grad: [G, 2] gradient of the projected centres, 1/pixels.
            visible: [G] bool, passed culling.
            size: Image width and height, pixels.
        """
        # Pixels to NDC units, so that the threshold does not depend on the resolution.
        half = sent(torch.tensor(size), screen_grad.device) / 2
        norm = (screen_grad * half).norm(dim=1)
        hit = visible.to(norm.dtype)
        self.gradient.index_add_(0, decoded.slots, norm * hit)
        self.drawn.index_add_(0, decoded.slots, hit)
        positive = decoded.opacity.detach().clamp(min=0).sum(dim=1)
        self.opacity.index_add_(0, decoded.anchors, positive)
        self.visits.index_add_(0, decoded.anchors, torch.ones_like(positive))


def merged(places: Sequence[GrowthStatistics], group: ProcessGroup) -> GrowthStatistics:
    """The sum over all views of a batch, of all processes; the same in each of them."""
    if len(places) == group.size == 1:
        return places[0]
    flat = [torch.cat(list(place.tensors().values())) for place in places]
    total = group.sum(pairwise_sum(flat))
    sizes = [len(t) for t in places[0].tensors().values()]
    return GrowthStatistics(*total.split(sizes))


@dataclass(frozen=True)
class Seeds:
    """New anchors: their cells, sizes and the parents they inherit from."""

    cells: np.ndarray  # [P, 3] int64
    log_size: np.ndarray  # [P] log of the growth cell, world units
    parent_of: Tensor  # [M] anchor row of each candidate
    row_of: Tensor  # [M] which new anchor it became
    gradient: Tensor  # [P] largest mean gradient among its candidates


def find_seeds(
    model: AnchorModel,
    statistics: GrowthStatistics,
    config: GrowthConfig,
    generator: torch.Generator,
    region: Region | None = None,
) -> list[Seeds]:
    """New anchors of each growth level where slots have a large gradient, within the region."""
    slots = model.slots
    # Per render: slots in many views would otherwise win by the number of their views.
    mean = statistics.gradient / statistics.drawn.clamp(min=1)
    eligible = statistics.drawn > config.every * config.grow_visits
    with torch.no_grad():
        x, _ = model.placed()
        centers = x[:, None] + model.offsets * model.log_scales[:, None, :3].exp()
        centers = centers.reshape(-1, 3)
    device, occupied = model.offsets.device, model.lattice.cpu().numpy()
    seeds: list[Seeds] = []
    for depth in range(LEVELS):
        cell = max(1, config.cell // 4**depth)
        # Random thinning as in Scaffold-GS: half of the slots stay at the coarsest cell, more at
        # finer ones. A number for every slot, on the CPU: all ranks and devices draw the same.
        luck = (torch.rand(len(mean), generator=generator) > 0.5 ** (depth + 1)).to(device)
        chosen = (eligible & (mean >= config.threshold * 2**depth) & luck).nonzero()[:, 0]
        spacing = model.frame.voxel * cell
        nodes = torch.round(centers[chosen].double() / spacing).long()
        if region is not None:
            inside = region.holds((nodes.double() * spacing).float())
            chosen, nodes = chosen[inside], nodes[inside]
        wanted = nodes.cpu().numpy()
        # A cell of this size that holds any anchor, of this round too, gets no other.
        taken = growth_cells(occupied, cell)
        # Rounded up: the limit counts lattice cells, candidates count cells of this size.
        cells, rows = free_cells(wanted, taken, limit=-(-KEY_LIMIT // cell))
        cells *= cell
        became = torch.from_numpy(rows).to(device)
        log_size = np.full(len(cells), math.log(spacing), dtype=np.float32)
        took = became >= 0
        strength = mean.new_zeros(len(cells))
        strength.scatter_reduce_(0, became[took], mean[chosen[took]], "amax")
        seeds.append(Seeds(cells, log_size, chosen[took] // slots, became[took], strength))
        occupied = np.concatenate([occupied, cells])
    return seeds


def adjust(
    model: AnchorModel,
    optimizer: Optimizer,
    statistics: GrowthStatistics,
    config: GrowthConfig,
    seeds: list[Seeds],
    moving: Tensor | None = None,
) -> GrowthStatistics:
    """Add the seeds, prune transparent anchors, edit optimizer rows, reset what was judged.

    Where there is room for some of the seeds only, those with the largest gradients are added.
    Only anchors that are `moving` are pruned, bool [N]; None: all may be.
    """
    visits_needed = config.every * config.prune_visits
    judged = statistics.visits > visits_needed
    transparent = judged & (statistics.opacity < PRUNE_OPACITY * statistics.visits)
    if moving is not None:
        transparent = transparent & moving
    # A model without anchors could not recover.
    keep = ~transparent if not transparent.all() else torch.ones_like(transparent)
    room = max(0, config.max_anchors - int(keep.sum()))
    rows = [_new_rows(model, s) for s in seeds]
    added = {n: torch.cat([r[n] for r in rows]) for n in rows[0]} if rows else {}
    if rows and len(added["lattice"]) > room:
        strength = torch.cat([s.gradient for s in seeds])
        # Stable, and back in the order of the seeds: rows must be the same on every rank.
        best = torch.sort(strength, descending=True, stable=True).indices[:room].sort().values
        added = {name: values[best] for name, values in added.items()}
    count = len(added["lattice"]) if added else 0
    edit_rows(model, optimizer, keep, added)
    # Judged rows start again from zero; the others keep counting until they have enough visits.
    slot_keep = keep.repeat_interleave(model.slots)
    eligible = statistics.drawn > config.every * config.grow_visits
    return GrowthStatistics(
        _extend(statistics.gradient.masked_fill(eligible, 0)[slot_keep], count * model.slots),
        _extend(statistics.drawn.masked_fill(eligible, 0)[slot_keep], count * model.slots),
        _extend(statistics.opacity.masked_fill(judged, 0)[keep], count),
        _extend(statistics.visits.masked_fill(judged, 0)[keep], count),
    )


def _new_rows(model: AnchorModel, seeds: Seeds) -> dict[str, Tensor]:
    """Rows of new anchors: size from the cell, features the maximum over their parents (§1.9.4)."""
    count, device = len(seeds.cells), model.offsets.device

    def inherit(values: Tensor) -> Tensor:
        out = values.new_full((count, values.shape[1]), -torch.inf)
        index = seeds.row_of[:, None].expand(-1, values.shape[1])
        return out.scatter_reduce(0, index, values[seeds.parent_of], "amax")

    with torch.no_grad():
        return {
            "lattice": torch.from_numpy(seeds.cells).to(device),
            "offsets": torch.zeros(count, model.slots, 3, device=device),
            "log_scales": torch.from_numpy(seeds.log_size).to(device)[:, None].repeat(1, 6),
            "logits": inherit(model.logits),
            "residual": inherit(model.residual),
        }


def edit_rows(
    model: AnchorModel,
    optimizer: Optimizer | None,
    keep: Tensor,
    added: Mapping[str, Tensor] | None = None,
) -> None:
    """Drop anchors, and add new ones after those that stay.

    Args:
        model: Its rows change.
        optimizer: Has the rows' moments; None: the phase has made none yet.
        keep: Anchors that stay, bool [N].
        added: Rows of the new ones, `lattice` and `ROW_PARAMETERS`; None or empty: there are none.
    """
    count = len(added["lattice"]) if added else 0
    for name in ROW_PARAMETERS:
        old: nn.Parameter = getattr(model, name)
        new = added[name] if added else old.data[:0]
        parameter = nn.Parameter(torch.cat([old.data[keep], new]))
        setattr(model, name, parameter)
        # Parameters without values, as a residual of width 0, are not in the optimizer.
        if optimizer is not None and (old.numel() or parameter.numel()):
            optimizer.replace(name, parameter, keep, count)
    lattice = added["lattice"] if added else model.lattice[:0]
    model.set_lattice(torch.cat([model.lattice[keep], lattice]))
    finest = model.part(-1)
    for part in model.level_parts():
        # New slots are live at the finest level; coarser ones take theirs when levels are ranked.
        new = part.mask.new_full((count, model.slots), part is finest)
        part.mask = torch.cat([part.mask[keep], new])


def _extend(values: Tensor, count: int) -> Tensor:
    return torch.cat([values, values.new_zeros(count)])
