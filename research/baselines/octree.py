"""Octree-GS: anchors on lattices of several sizes, drawn by their distance (methods.md §6.7).

Written from the published description. Letters: N anchors, K slots, L lattices, 0 the coarsest.
An anchor's lattice is in its coordinates, which count halves of the finest cells: those of a cell's
middle are odd multiples of half its edge. So a file needs no column for it.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gsynopsis.config import RATES, GrowthConfig, ModelConfig
from gsynopsis.errors import DivergedError
from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.build import new_model
from gsynopsis.model.lattice import KEY_LIMIT, auto_voxel, free_cells, lattice_keys
from gsynopsis.model.splats import FileModel
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import STILL, Camera, positions_of
from gsynopsis.scene.scene import Scene
from gsynopsis.training.growth import GrowthStatistics, Seeds, adjust
from gsynopsis.training.losses import SSIM_WEIGHT
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.optim.param_groups import part_parameters, rates_of, shared_parameters
from gsynopsis.training.regularize.jitter import shift_places
from gsynopsis.training.step import draw_jitter
from gsynopsis.training.view_step import count_view, photometric_loss, volume_loss
from research.baselines.gaussians import AVERAGED, Training, photo

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]
NOTE = "octree"
"""Name of the manifest's note: lattices, and the distance from which only the coarsest is drawn."""
VOLUME_WEIGHT = 0.01
GROW_FROM, GROW_UNTIL, OPEN_BY = 1.5 / 40, 25 / 40, 10 / 40
"""Shares of the steps: where growth begins and ends, and where all lattices are open."""
COARSE_FACTOR = 1.5
"""By which each lattice opens sooner after the one before."""
FARTHEST = 0.999
"""Quantile of the distances from cameras to points that counts as the largest."""
FORK = 2
UPDATE_RATIO = 0.2
"""A lattice's threshold of growth is its parent's times the fork to this power."""
MOST_LATTICES = 10
POINTS = 20_000
"""Most points whose distances are measured."""


@dataclass(frozen=True)
class OctreeGate:
    """Rule for the lattices that are rendered at a distance.

    Attributes:
        lattices: L.
        reach: Distance at which only the coarsest is drawn, world units; at half of it two are.
        opened: Lattices that are drawn at all.
    """

    lattices: int
    reach: float
    opened: int

    @staticmethod
    def of(points: Float64, eyes: Float64) -> "OctreeGate":
        """The rule for a scene's points [P, 3] and cameras [V, 3], all lattices open."""
        some = points[:: max(1, len(points) // POINTS)]
        away = np.stack([np.linalg.norm(some - eye, axis=1) for eye in eyes])
        near, far = np.quantile(away, (1 - FARTHEST, FARTHEST))
        spread = math.log(far / max(float(near), 1e-9 * float(far)), FORK) if far > 0 else 0.0
        lattices = min(MOST_LATTICES, max(1, round(spread) + 1))
        return OctreeGate(lattices, float(far), lattices)

    @property
    def first(self) -> int:
        """The finest lattice with which training begins."""
        return self.lattices // 2

    def finest(self, distances: Tensor) -> Tensor:
        """The finest lattice that is drawn at each distance, int64, as `distances`."""
        wanted = torch.round(torch.log2(self.reach / distances.clamp(min=1e-12)))
        return wanted.clamp(0, self.opened - 1).long()

    def at_progress(self, progress: float) -> "OctreeGate":
        """As training opens one lattice after the other, each after a shorter while."""
        later = self.lattices - 1 - self.first
        if later <= 0 or progress >= OPEN_BY:
            return replace(self, opened=self.lattices)
        q = 1 / COARSE_FACTOR
        wait, opened, due = OPEN_BY * (1 - q) / (1 - q**later), self.first + 1, 0.0
        for number in range(later):
            due += wait * q**number
            opened += progress >= due
        return replace(self, opened=min(opened, self.lattices))

    def cells(self, places: Float64, lattice: int, half: float) -> Int64:
        """Middles of the cells around places [P, 3], in halves of the finest cells, int64 [P, 3].

        Args:
            places: World units.
            lattice: Which.
            half: Of the finest cell's edge, world units.
        """
        middle = 1 << (self.lattices - 1 - lattice)
        return (2 * np.floor(places / (2 * middle * half)).astype(np.int64) + 1) * middle

    def lattice_of(self, cells: Tensor) -> Tensor:
        """The lattice of each anchor [N] by its coordinates [N, 3], int64."""
        middle = cells[:, 0] & -cells[:, 0]
        return self.lattices - 1 - torch.log2(middle.double()).round().long()

    def shares(self, cells: Int64, eyes: Float64, half: float) -> Float64:
        """The share of the cameras from whose distance each anchor is drawn, [N]."""
        places = torch.from_numpy(cells * half)
        own = self.lattice_of(torch.from_numpy(cells))
        whole, seen = replace(self, opened=self.lattices), torch.zeros(len(cells))
        for eye in torch.from_numpy(eyes):
            seen += whole.finest((places - eye).norm(dim=1)) >= own
        return (seen / max(1, len(eyes))).double().numpy()


class OctreeModel(AnchorModel):
    """An anchor model from which a camera sees the lattices that its distance asks for."""

    gate: OctreeGate

    @staticmethod
    def of(model: AnchorModel, gate: OctreeGate) -> "OctreeModel":
        """Another model's tensors, which are not copied."""
        found = OctreeModel(model.frame, model.layout)
        found.set_lattice(model.lattice)
        found.codes, found.seen, found.parts = model.codes, model.seen, model.parts
        for name in ("offsets", "log_scales", "logits", "residual", "table"):
            setattr(found, name, getattr(model, name))
        found.gate = gate
        return found

    def visible(self, part: LevelPart, camera: Camera) -> Tensor:
        """Anchors that could touch the image and are not too fine for their distance, int64 [V]."""
        rows = super().visible(part, camera)
        places = self.placed()[0][rows]
        eye = torch.as_tensor(camera.position, dtype=places.dtype, device=places.device)
        finest = self.gate.finest((places - eye).norm(dim=1))
        return rows[self.gate.lattice_of(self.lattice[rows]) <= finest]


def gate_text(gate: OctreeGate) -> str:
    """The note, JSON."""
    return json.dumps({"lattices": gate.lattices, "reach": gate.reach})


def gated(model: FileModel, meta: Mapping[str, str]) -> FileModel:
    """A file's model as it was trained: by distance where its notes say so."""
    if NOTE not in meta or not isinstance(model, AnchorModel):
        return model
    told = json.loads(meta[NOTE])
    return OctreeModel.of(model, OctreeGate(told["lattices"], told["reach"], told["lattices"]))


def caps(lattices: int, levels: int) -> list[int]:
    """The finest lattice of each level, evenly spread; no more levels than lattices."""
    last, steps = lattices - 1, levels - 1
    return sorted({last - round((steps - k) * last / steps) for k in range(levels)})


class OctreeTraining:
    """Anchors with plain features on all lattices, grown on their own and the next finer one."""

    def __init__(self, scene: Scene, renderer: Renderer, training: Training) -> None:
        """Anchors at the scene's points.

        Args:
            scene: Photos and cameras.
            renderer: With gradients.
            training: Steps, scale, seed, subpixels and most anchors are read.
        """
        self.scene, self.renderer, self.training = scene, renderer, training
        self.scale, self.steps, seed = training.scale, training.steps, training.seed
        self.growth = GrowthConfig(max_anchors=training.most)
        self.chance = np.random.default_rng(seed)
        self.eyes = positions_of(scene.camera(view, self.scale) for view in scene.train)
        gate = OctreeGate.of(scene.points, self.eyes)
        edge = auto_voxel(scene.points, scene.extent)
        half = max(edge / 2 ** (gate.lattices - gate.first), 2 * scene.extent / KEY_LIMIT)
        cells = self._first_cells(gate, half)
        settings = ModelConfig(feature="free", voxel=half)
        luck = torch.Generator().manual_seed(seed)
        model = OctreeModel.of(new_model(scene, settings, luck), gate)
        self.model = model.to(renderer.device)
        self._place(cells)
        free = shared_parameters(model) | part_parameters(model.part(-1), "", level_scale=False)
        extent = model.frame.extent
        self.optimizer = Optimizer(free, rates_of(free, RATES["ours"], extent, free=True))
        self.statistics = self._nothing_seen()

    def _first_cells(self, gate: OctreeGate, half: float) -> Int64:
        """Occupied cells of every lattice, without those too fine for most cameras.

        The backdrop (methods.md §2.16) is on the coarsest.
        """
        points = self.scene.points
        places = [np.concatenate([points, self.scene.backdrop])] + [points] * (gate.lattices - 1)
        found = [
            np.unique(gate.cells(of_lattice, lattice, half), axis=0)
            for lattice, of_lattice in enumerate(places)
        ]
        cells = np.concatenate(found)
        cells = cells[(np.abs(cells) < KEY_LIMIT).all(axis=1)]
        shares = gate.shares(cells, self.eyes, half)
        self.least_share = float(shares.mean())
        return cells[shares >= self.least_share]

    def _place(self, cells: Int64) -> None:
        """Rows for cells, each as large as its cell."""
        model, gate = self.model, self.model.gate
        slots, count = model.slots, len(cells)
        lattice = torch.from_numpy(cells)
        edges = 2.0 ** (gate.lattices - gate.lattice_of(lattice)).double() * model.frame.voxel
        model.set_lattice(lattice.to(model.offsets.device))
        device = model.offsets.device
        model.offsets = nn.Parameter(torch.zeros(count, slots, 3, device=device))
        model.log_scales = nn.Parameter(edges.log().float()[:, None].repeat(1, 6).to(device))
        model.logits = nn.Parameter(torch.zeros(count, 0, device=device))
        width = model.residual.shape[1]
        model.residual = nn.Parameter(torch.zeros(count, width, device=device))
        model.part(-1).mask = torch.ones(count, slots, dtype=torch.bool, device=device)

    def _nothing_seen(self) -> GrowthStatistics:
        model = self.model
        return GrowthStatistics.zeros(len(model), model.slots, model.offsets.device)

    def run(self, tick: Callable[[int, int], None] | None) -> OctreeModel:
        """Train to the end; all lattices are open then.

        Raises:
            DivergedError: a loss or an opacity is not finite.
            SceneError: a photo cannot be decoded.
        """
        left: list[int] = []
        for number in range(1, self.steps + 1):
            left = left or self.chance.permutation(self.scene.train).tolist()
            self.model.gate = self.model.gate.at_progress(number / self.steps)
            self._step(number, left.pop())
            late = number - round(self.steps * (1 - AVERAGED))
            if late > 0:
                self.optimizer.average(1 / late)
            if tick:
                tick(number, self.steps)
        with torch.no_grad():
            self.optimizer.take_average()
        self.model.gate = self.model.gate.at_progress(1.0)
        return self.model

    def _step(self, number: int, view: int) -> None:
        model, scene = self.model, self.scene
        shifts = shift_places(self.training.subpixels)
        shift = draw_jitter(self.chance, shifts) if len(shifts) > 1 else STILL
        camera = scene.camera(view, self.scale, shift)
        decoded = model.decode_level(-1, camera)
        device = model.offsets.device
        black = torch.zeros(3, device=device)
        rendering = self.renderer.render(decoded.gaussians, camera, black)
        truth = photo(scene, view, self.scale, device, shift)
        loss = photometric_loss(rendering.image, truth, SSIM_WEIGHT)
        loss = loss + VOLUME_WEIGHT * volume_loss(decoded.gaussians.scales)
        # A slot whose opacity is NaN is not rendered, so the loss alone would not tell.
        if not bool(torch.isfinite(loss.detach() + decoded.opacity.detach().sum())):
            raise DivergedError(f"Octree-GS: the loss of step {number} is not finite")
        loss.backward()
        if number < GROW_UNTIL * self.steps:
            count_view(self.statistics, decoded, rendering)
        self.optimizer.set_progress(number / self.steps)
        self.optimizer.step()
        within = GROW_FROM * self.steps < number < GROW_UNTIL * self.steps
        if within and number % self.growth.every == 0:
            self._grow()

    def _grow(self) -> None:
        """New anchors, none where few cameras would draw them; transparent ones go."""
        model = self.model
        seeds, finer = find_finer(model, self.statistics, self.growth)
        seeds = [self._worth_it(found) for found in seeds]
        self.statistics = adjust(model, self.optimizer, self.statistics, self.growth, seeds)
        born = np.concatenate([seeds[i].cells for i in finer]) if finer else np.zeros((0, 3))
        keys = lattice_keys(born.astype(np.int64))
        rows = np.isin(lattice_keys(model.lattice.cpu().numpy()), keys).nonzero()[0]
        with torch.no_grad():
            model.residual[torch.from_numpy(rows).to(model.residual.device)] = 0

    def _worth_it(self, seeds: Seeds) -> Seeds:
        half = self.model.frame.voxel
        shares = self.model.gate.shares(seeds.cells, self.eyes, half)
        keep = torch.from_numpy(shares >= self.least_share)
        device = seeds.row_of.device
        row = torch.where(keep, keep.cumsum(0) - 1, -1).to(device)[seeds.row_of]
        kept = keep.numpy()
        return Seeds(
            seeds.cells[kept],
            seeds.log_size[kept],
            seeds.parent_of[row >= 0],
            row[row >= 0],
            seeds.gradient[keep.to(device)],
        )


def find_finer(
    model: OctreeModel, statistics: GrowthStatistics, config: GrowthConfig
) -> tuple[list[Seeds], list[int]]:
    """New anchors, and which of the lists are of finer lattices than their parents'.

    A slot whose gradient reaches its lattice's threshold grows there; one that reaches the next
    lattice's grows on that one alone, once all lattices are open, and on the last one not at all.
    Those of finer lattices begin without features.
    """
    slots, gate = model.slots, model.gate
    mean = statistics.gradient / statistics.drawn.clamp(min=1)
    eligible = statistics.drawn > config.every * config.grow_visits
    with torch.no_grad():
        x, _ = model.placed()
        centers = x[:, None] + model.offsets * model.log_scales[:, None, :3].exp()
    places = centers.reshape(-1, 3).double().cpu().numpy()
    own = gate.lattice_of(model.lattice).repeat_interleave(slots)
    occupied = model.lattice.cpu().numpy()
    seeds, finer = list[Seeds](), list[int]()
    for lattice in range(gate.opened):
        least = config.threshold * FORK ** (UPDATE_RATIO * lattice)
        here = eligible & (own == lattice) & (mean >= least)
        deeper = here & (mean >= least * FORK**UPDATE_RATIO)
        may = gate.opened == gate.lattices and lattice + 1 < gate.lattices
        finer_ones = deeper if may else torch.zeros_like(deeper)
        for target, chosen in ((lattice, here & ~deeper), (lattice + 1, finer_ones)):
            rows = chosen.nonzero()[:, 0]
            if not len(rows):
                continue
            if target > lattice:
                finer.append(len(seeds))
            wanted = gate.cells(places[rows.cpu().numpy()], target, model.frame.voxel)
            found = _seeds(wanted, occupied, rows, mean)
            edge = 2 ** (gate.lattices - target) * model.frame.voxel
            found = replace(found, log_size=np.full(len(found.cells), math.log(edge), np.float32))
            found = replace(found, parent_of=found.parent_of // slots)
            seeds.append(found)
            occupied = np.concatenate([occupied, found.cells])
    return seeds, finer


def _seeds(wanted: Int64, occupied: Int64, rows: Tensor, mean: Tensor) -> Seeds:
    """Free cells among those wanted; parents are slots, sizes missing."""
    cells, row_of = free_cells(wanted, occupied)
    became = torch.from_numpy(row_of).to(rows.device)
    took = became >= 0
    strength = mean.new_zeros(len(cells))
    strength.scatter_reduce_(0, became[took], mean[rows[took]], "amax")
    return Seeds(cells, np.zeros(len(cells), np.float32), rows[took], became[took], strength)


def with_levels(model: OctreeModel, count: int) -> None:
    """Give the model at most `count` levels, each ending with a lattice, with the same networks."""
    part = model.part(-1)
    lattice = model.gate.lattice_of(model.lattice)
    parts = list[LevelPart]()
    for cap in caps(model.gate.lattices, count):
        mask = part.mask & (lattice <= cap)[:, None]
        networks = {name: p.detach().clone() for name, p in part.networks.items()}
        parts.append(LevelPart(mask, part.grids, part.codebook.detach().clone(), networks))
    model.parts = nn.ModuleList(parts)
