"""A fresh model from a scene's points, and models from and to records."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gsynopsis.config import GRID_RESOLUTIONS, ModelConfig
from gsynopsis.errors import SceneError
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel, LevelPart
from gsynopsis.model.encoding import GridLayout, grid_layout, layout_of
from gsynopsis.model.heads import init_networks
from gsynopsis.model.lattice import (
    KEY_LIMIT,
    auto_voxel,
    initial_lattice,
    initial_log_scales,
    least_voxel,
)
from gsynopsis.model.training_focals import parse_focals
from gsynopsis.model.view_bounds import parse_view_bounds
from gsynopsis.records import (
    FOCALS_NOTE,
    NETWORK_NAMES,
    SEEN_NOTE,
    Frame,
    Level,
    LevelSet,
    Shared,
    morton_order,
)
from gsynopsis.scene.scene import Scene

FREE_WIDTH = 32
"""Values per anchor of the control `feature = "free"` (Scaffold's)."""
OPACITY_BIAS = 0.3
"""Added to the first biases of the opacity head where its output is scaled up, so that most slots
show at the start (ours: half of them never did, more or less by seed; methods.md §2.6)."""
CODEBOOK_DIM = 32
"""Values per codebook row (§1.4)."""
FUSE_WIDTHS = (64, 32)
"""Hidden and output width of the fusion MLP (§1.5)."""

BOX_SHARE = 0.98
"""Share of the points, along each axis, that a box is made for: few far ones would decide it."""
BOX_WIDER = 1.2
"""Factor on the half width of that box (HAC)."""

CELL_PIXELS = 1.8
"""Pixels of a photo that a lattice cell covers at most, at the median sparse point (ours, §1.2)."""
FINER = 1.5
"""Times finer than the points' distance, from which on photos ask for a cell: one a quarter finer
cost alexander 0.3 dB at equal bytes and its finest level 0.2 (two seeds, validation photos)."""
MOST_VIEWS, MOST_POINTS = 64, 4096
"""Photos and points that are used for it, evenly spread, about."""


def make_frame(scene: Scene, config: ModelConfig) -> Frame:
    """Voxel, bounds and extent from a scene; fixed for ever after (methods.md §1.2, §1.3)."""
    points = scene.points
    voxel = config.voxel or auto_voxel(points, scene.extent)
    if config.bounds == "aabb":
        low, high = np.quantile(points, (1 - BOX_SHARE) / 2 + np.array([0, BOX_SHARE]), axis=0)
        radius = max(float((high - low).max()) / 2 * BOX_WIDER, voxel)
        return Frame(voxel, (low + high) / 2, radius, False, scene.extent)
    center = np.median(points, axis=0)
    radius = float(np.quantile(np.abs(points - center).max(axis=1), 0.9))
    return Frame(voxel, center, max(radius, voxel), True, scene.extent)


def photo_cell(scene: Scene, scale: float) -> float | None:
    """The lattice cell that photos ask for, world units; None where points lie near it (§1.2).

    Sparse points of large photos lie many pixels apart: on a lattice as coarse as that, growth
    ends long before such photos are shown.

    Args:
        scene: Whose sparse points and training photos.
        scale: Photos are divided by this.
    """
    views = scene.train[:: 1 + len(scene.train) // MOST_VIEWS]
    points = scene.points[:: 1 + len(scene.points) // MOST_POINTS]
    cameras = [scene.camera(view, scale) for view in views]
    seen = np.concatenate([camera.framed(points).depths / camera.fx for camera in cameras])
    if not len(seen):
        return None
    cell = max(CELL_PIXELS * float(np.median(seen)), least_voxel(scene.points))
    return cell if FINER * cell < auto_voxel(scene.points, scene.extent) else None


def grid_resolutions(config: ModelConfig) -> tuple[int, ...]:
    """Resolutions of the grids this model has; the control `free` has none."""
    return () if config.feature == "free" else GRID_RESOLUTIONS[: config.grids]


def initial_points(scene: Scene, config: ModelConfig) -> NDArray[np.float64]:
    """First anchors of a model: sparse points, and the backdrop with contraction, [P, 3]."""
    if config.bounds != "contract":
        return scene.points
    return np.concatenate([scene.points, scene.backdrop])


def new_model(scene: Scene, config: ModelConfig, generator: torch.Generator) -> AnchorModel:
    """The untrained full model: anchors at the scene's occupied cells, one part."""
    frame = make_frame(scene, config)
    lattice = initial_lattice(initial_points(scene, config), frame.voxel)
    if len(lattice) == 0:
        raise SceneError(
            scene.root,
            "points",
            found=f"none within {KEY_LIMIT:,} cells of {frame.voxel:.3g} around the origin",
            expected="some",
            advice="move the scene to the origin, or set model.voxel to a larger cell",
        )
    free = config.feature == "free"
    resolutions = grid_resolutions(config)
    layout = grid_layout(resolutions, config.table_log2)
    model = AnchorModel(frame, layout)
    model.set_lattice(torch.from_numpy(lattice))
    count, slots = len(lattice), config.slots
    codes = 0 if free else config.codebook
    residual = FREE_WIDTH if free else config.residual
    model.offsets = nn.Parameter(torch.zeros(count, slots, 3))
    model.log_scales = nn.Parameter(
        torch.from_numpy(initial_log_scales(lattice.astype(np.float64) * frame.voxel, frame.voxel))
    )
    model.logits = nn.Parameter(torch.randn(count, codes, generator=generator) * 0.01)
    model.residual = nn.Parameter(torch.zeros(count, residual))
    rand = torch.rand(layout.rows, layout.features, generator=generator)
    model.table = nn.Parameter((rand * 2 - 1) * 1e-4)
    codebook = torch.randn(codes, CODEBOOK_DIM if codes else 0, generator=generator) * 0.1
    width = len(resolutions) * layout.features + codebook.shape[1] + residual
    fuse = FUSE_WIDTHS if config.fusion == "mlp" and not free else None
    scale = config.opacity_init_scale
    opacity = (OPACITY_BIAS if scale > 1 else 0.0, scale)
    networks = init_networks(width, slots, config.hidden, fuse, generator, opacity)
    mask = torch.ones(count, slots, dtype=torch.bool)
    model.parts.append(LevelPart(mask, len(resolutions), codebook, networks))
    return model


def model_from_levels(levels: LevelSet) -> AnchorModel:
    """A model that renders a decoded file; rows keep the file's order."""
    shared = levels.shared
    sizes = [len(g) for g in shared.grids]
    features = int(shared.grids[0].shape[1]) if sizes else 4
    layout = layout_of(tuple(shared.grid_resolutions), sizes, features)
    model = AnchorModel(levels.frame, layout)
    model.set_lattice(torch.from_numpy(shared.lattice.astype(np.int64)))
    model.codes = torch.from_numpy(shared.codes.astype(np.int64))
    model.offsets = nn.Parameter(_tensor(shared.offsets))
    model.log_scales = nn.Parameter(_tensor(shared.log_scales))
    model.residual = nn.Parameter(_tensor(shared.residual))
    model.logits = nn.Parameter(torch.zeros(len(model), 0))
    if sizes:
        model.table = nn.Parameter(_tensor(np.concatenate(list(shared.grids))))
    model.seen = parse_view_bounds(levels.meta.get(SEEN_NOTE))
    focals = parse_focals(levels.meta.get(FOCALS_NOTE), len(levels.levels))
    for number, level in enumerate(levels.levels):
        mask = torch.zeros(len(model), model.slots, dtype=torch.bool)
        mask[: level.anchors] = torch.from_numpy(level.mask)
        networks = {name: _tensor(weight) for name, weight in level.networks.items()}
        part = LevelPart(mask, level.grids, _tensor(level.codebook), networks)
        # Through float64, so that exp gives back the float32 level scale that was stored.
        part.log_gain.data = torch.from_numpy(np.log(level.gain.astype(np.float64))).float()
        part.quality = dict(level.quality)
        part.focals = focals[number] if focals else None
        model.parts.append(part)
    return model


def model_to_levels(model: AnchorModel, meta: dict[str, str]) -> LevelSet:
    """The record of a trained model: rows ordered, dead slots zeroed, dead anchors dropped."""
    with torch.no_grad():
        masks = torch.stack([model.part(k).mask for k in range(len(model.parts))])  # [L, N, K]
        alive = masks.any(dim=2)
        first = torch.where(alive.any(dim=0), alive.int().argmax(dim=0), len(masks))
        order = _order(model.lattice, first.cpu(), len(masks))
        rows = order.to(model.lattice.device)
        offsets = model.offsets[rows] * masks[-1][rows][:, :, None]
        shared = Shared(
            lattice=model.lattice[rows].cpu().numpy().astype(np.int32),
            log_scales=_array(model.log_scales[rows]),
            offsets=_array(offsets),
            codes=_codes(model, rows),
            residual=_array(model.residual[rows]),
            grids=_grids(model.table, model.layout),
            grid_resolutions=model.layout.resolutions,
        )
        counts = [int((first <= k).sum()) for k in range(len(masks))]
        levels = [
            _level(model.part(k), masks[k][rows[:n]].cpu().numpy()) for k, n in enumerate(counts)
        ]
        return LevelSet(model.frame, shared, tuple(levels), meta)


def select_anchors(model: AnchorModel, keep: Tensor) -> AnchorModel:
    """A model of some anchors, bool [N], with the same networks and levels, which it shares."""
    chosen = AnchorModel(model.frame, model.layout)
    chosen.set_lattice(model.lattice[keep])
    chosen.codes = model.codes[keep] if len(model.codes) else model.codes
    for name in ROW_PARAMETERS:
        setattr(chosen, name, nn.Parameter(getattr(model, name).detach()[keep]))
    chosen.table, chosen.seen = model.table, model.seen
    for part in model.level_parts():
        own = LevelPart(part.mask[keep], part.grids, part.codebook, {})
        own.codebook, own.networks, own.log_gain = part.codebook, part.networks, part.log_gain
        own.quality, own.focals = part.quality, part.focals
        chosen.parts.append(own)
    return chosen


def freeze_codes(model: AnchorModel) -> None:
    """Replace the soft index by its largest entry; nothing that is rendered changes (§1.10)."""
    if model.logits.shape[1]:
        model.codes = model.logits.detach().argmax(dim=1)
        model.logits = nn.Parameter(torch.zeros(len(model), 0, device=model.logits.device))


def _order(lattice: Tensor, first: Tensor, levels: int) -> Tensor:
    """Rows of anchors that live at some level, by first level, then by Morton code."""
    appears = first.numpy()
    morton = morton_order(lattice.cpu().numpy().astype(np.int32))
    keep = morton[appears[morton] < levels]
    return torch.from_numpy(keep[np.argsort(appears[keep], kind="stable")])


def _level(part: LevelPart, mask: np.ndarray) -> Level:
    return Level(
        mask=mask,
        grids=part.grids,
        codebook=_array(part.codebook),
        networks={n: _array(part.networks[n]) for n in NETWORK_NAMES if n in part.networks},
        gain=_array(part.log_gain.exp()),
        quality=dict(part.quality),
    )


def _codes(model: AnchorModel, rows: Tensor) -> np.ndarray:
    """Codebook rows of some anchors, uint8; none where there is no codebook."""
    if not model.logits.shape[1] and not len(model.codes):
        return np.zeros(0, np.uint8)
    codes = model.logits.argmax(dim=1) if model.logits.shape[1] else model.codes
    return codes[rows].cpu().numpy().astype(np.uint8)


def _grids(table: Tensor, layout: GridLayout) -> tuple[np.ndarray, ...]:
    flat = _array(table)
    return tuple(flat[o : o + s].copy() for o, s in zip(layout.offsets, layout.sizes, strict=True))


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(array, dtype=np.float32, copy=True))


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy().astype(np.float32, copy=True)
