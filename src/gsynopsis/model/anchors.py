"""The anchor model: shared tensors, level parts, and their decoding into Gaussians."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from gsynopsis.model.decode import assemble, compute_heads, visible_rows_reference
from gsynopsis.model.encoding import GridLayout, coarsest_grids, grid_coordinates
from gsynopsis.model.native_view import NativePass, native_rows
from gsynopsis.model.tables import (
    WEIGHTS,
    Decoded,
    HeadInputs,
    LevelInputs,
    SlotTables,
    ViewInput,
)
from gsynopsis.model.view_bounds import Point, ViewBounds
from gsynopsis.records import Frame, positions
from gsynopsis.render.base import Gaussians, Renderer, TrainingFocals
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera

ROW_PARAMETERS = ("offsets", "log_scales", "logits", "residual")
"""Parameters of a model with a row for each anchor."""


class LevelPart(nn.Module):
    """Parameters of one level: its mask and the parts it replaces (methods.md §1.12, §1.13)."""

    mask: Tensor  # [N, K] bool

    def __init__(
        self, mask: Tensor, grids: int, codebook: Tensor, networks: dict[str, Tensor]
    ) -> None:
        """Takes the tensors over; the level scale starts at one."""
        super().__init__()
        self.register_buffer("mask", mask)
        self.grids = grids
        self.codebook = nn.Parameter(codebook)
        self.networks = nn.ParameterDict({k: nn.Parameter(v) for k, v in networks.items()})
        self.log_gain = nn.Parameter(torch.zeros(3, device=codebook.device))
        self.quality: dict[str, float] = {}
        self.focals: TrainingFocals | None = None


@dataclass(frozen=True)
class LearntMask:
    """A mask while it is learnt: a slot is rendered where σ(logit) > threshold (§1.11.4).

    Opacity and scale of a rendered slot carry the straight-through gradient of σ.
    """

    logits: Tensor  # [N, K]
    threshold: float

    def live(self) -> Tensor:
        """Slots over the threshold, [N, K] bool."""
        return self.logits.detach().sigmoid() > self.threshold

    def gate(self, gaussians: Gaussians, slots: Tensor) -> Gaussians:
        """The same values, with the gradient of σ on opacity and scale; slots are flat [G]."""
        soft = self.logits.reshape(-1)[slots].sigmoid()
        gate = 1 + soft - soft.detach()
        return replace(
            gaussians,
            opacities=gaussians.opacities * gate,
            scales=gaussians.scales * gate[:, None],
        )


class AnchorModel(nn.Module):
    """N anchors with K slots each, shared grids, and level parts, coarsest first.

    While the full model trains there is one part. The choice of codebook rows is held as `logits`
    while training and as `codes` once frozen; exactly one of them is there.
    """

    lattice: Tensor  # [N, 3] int64
    codes: Tensor  # [N] int64 or [0]

    def __init__(self, frame: Frame, layout: GridLayout) -> None:
        """An empty model; `build` and `from_levels` fill it."""
        super().__init__()
        self.frame = frame
        self.layout = layout
        self.register_buffer("lattice", torch.zeros(0, 3, dtype=torch.int64))
        self.register_buffer("codes", torch.zeros(0, dtype=torch.int64))
        self.offsets = nn.Parameter(torch.zeros(0, 1, 3))
        self.log_scales = nn.Parameter(torch.zeros(0, 6))
        self.logits = nn.Parameter(torch.zeros(0, 0))
        self.residual = nn.Parameter(torch.zeros(0, 0))
        self.table = nn.Parameter(torch.zeros(layout.rows, layout.features))
        self.parts = nn.ModuleList()
        self.seen: ViewBounds | None = None
        self._placed: tuple[Tensor, Tensor] | None = None

    def __len__(self) -> int:
        return self.lattice.shape[0]

    @property
    def slots(self) -> int:
        """K."""
        return self.offsets.shape[1]

    def part(self, level: int) -> LevelPart:
        """The part of a level; -1 is the finest."""
        return self.parts[level]  # type: ignore[return-value]

    def level_parts(self) -> list[LevelPart]:
        """The parts of all levels, coarsest first."""
        return [self.part(level) for level in range(len(self.parts))]

    def set_lattice(self, lattice: Tensor) -> None:
        """Replace the anchors' cells, int64 [N, 3]; positions follow."""
        self.lattice = lattice
        self._placed = None

    def placed(self) -> tuple[Tensor, Tensor]:
        """Positions float32 [N, 3] in world units and grid coordinates [N, 3], kept until moved."""
        if self._placed is None or self._placed[0].device != self.offsets.device:
            cells = self.lattice.cpu().numpy().astype(np.int32)
            x = torch.from_numpy(positions(self.frame, cells)).to(self.offsets.device)
            self._placed = x, grid_coordinates(x, self.frame)
        return self._placed

    def decode(self, camera: Camera, level: int = -1) -> Gaussians:
        """The Gaussians of a level that a camera sees, ready for a renderer (methods.md §1.6)."""
        return self.decode_part(self.part(level), camera).gaussians

    def decode_level(self, level: int, camera: Camera) -> Decoded:
        """As `decode`, with where each Gaussian comes from."""
        return self.decode_part(self.part(level), camera)

    def decode_part(
        self, part: LevelPart, camera: Camera, learnt: LearntMask | None = None
    ) -> Decoded:
        """Decode one part for one camera, with autograd.

        Args:
            part: One of this model's parts, or a candidate for one.
            camera: Any camera.
            learnt: The mask that is being learnt, within the part's own.
        """
        tables, rows = self._slot_tables(part), self.visible(part, camera)
        sources = self._head_inputs(part, rows)
        heads = compute_heads(sources, self.view_input(camera), dict(part.networks.items()))
        if learnt is not None:
            tables = replace(tables, live=part.mask & learnt.live())
        made = assemble(heads, rows, tables)
        gaussians = made.gaussians
        if learnt is not None:
            gaussians = learnt.gate(gaussians, made.slots)
        gaussians = replace(gaussians, focals=part.focals)
        return Decoded(gaussians, rows, made.slots, made.opacity)

    def native_pass(self, renderer: Renderer, part: LevelPart, camera: Camera) -> NativePass:
        """As `decode_part`, ready to be rendered, without autograd; only where `is_native`."""
        assert isinstance(renderer, CpuRenderer)
        inputs = LevelInputs(
            self._slot_tables(part),
            self._head_inputs(part, self.visible(part, camera)),
            self.view_input(camera),
            tuple(part.networks[name] for name in WEIGHTS),
            part.focals,
        )
        return NativePass(renderer, camera, inputs)

    def is_native(self, part: LevelPart) -> bool:
        """True if native kernels decode a part: on the CPU in float32, without a fusion MLP."""
        here = self.offsets.device.type == "cpu" and self.offsets.dtype == torch.float32
        return here and "fuse_w1" not in part.networks

    def _head_inputs(self, part: LevelPart, rows: Tensor) -> HeadInputs:
        x, u = self.placed()
        layout = coarsest_grids(self.layout, part.grids)
        choice = (self.logits, self.codes, part.codebook)
        return HeadInputs(rows, x, u, layout, self.table, *choice, self.residual)

    def view_input(self, camera: Camera) -> ViewInput:
        """The heads' input for a camera, within the training cameras' bounds if those are known."""
        extent, seen = self.frame.extent, self.seen
        position: Point = tuple(camera.position.tolist())
        if seen is None:
            return ViewInput(position, extent)
        return ViewInput(seen.nearest(position), extent, seen.low, seen.high)

    def visible(self, part: LevelPart, camera: Camera) -> Tensor:
        """Anchors of a part that could touch the image, int64 [V] ascending; see `native_rows`."""
        tables = self._slot_tables(part)
        if tables.offsets.device.type == "cpu" and tables.offsets.dtype == torch.float32:
            return native_rows(tables, camera)
        return visible_rows_reference(tables, camera)

    def _slot_tables(self, part: LevelPart) -> SlotTables:
        x, _ = self.placed()
        return SlotTables(x, self.log_scales, self.offsets, part.mask, part.log_gain)
