"""The anchor model: shared tensors, level parts, and their decoding into Gaussians."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from gsynopsis.model.assemble import SlotsPass, SlotTables, assemble
from gsynopsis.model.culling import visible_rows
from gsynopsis.model.encoding import GridLayout, grid_coordinates
from gsynopsis.model.heads_kernel import WEIGHTS, HeadInputs, HeadsKernel, ViewInput, compute_heads
from gsynopsis.model.view_bounds import Point, ViewBounds
from gsynopsis.records import Frame, positions
from gsynopsis.render.base import Gaussians, TrainingFocals
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


@dataclass(frozen=True)
class Decoded:
    """The Gaussians of one view and where they come from.

    Attributes:
        gaussians: G Gaussians, the live slots with positive opacity of visible anchors.
        anchors: Visible anchors, rows of the model, int64 [V].
        slots: Of each Gaussian its flat slot, row · K + slot, int64 [G].
        opacity: Head output of all slots of visible anchors, [V, K] in (-1, 1), without gradient.
    """

    gaussians: Gaussians
    anchors: Tensor
    slots: Tensor
    opacity: Tensor


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
        """Decode one part for one camera.

        Args:
            part: One of this model's parts, or a candidate for one.
            camera: Any camera.
            learnt: The mask that is being learnt, within the part's own.
        """
        tables = self._slot_tables(part)
        sources, view = self._inputs(part, camera)
        rows = sources.rows
        heads = compute_heads(sources, view, dict(part.networks.items()))
        if learnt is not None:
            tables = replace(tables, live=part.mask & learnt.live())
        made = assemble(heads, rows, tables)
        gaussians = made.gaussians
        if learnt is not None:
            gaussians = learnt.gate(gaussians, made.slots)
        gaussians = replace(gaussians, focals=part.focals)
        return Decoded(gaussians, rows, made.slots, made.opacity)

    def decode_pass(self, part: LevelPart, camera: Camera) -> "DecodePass":
        """`decode_part` and its gradients without autograd: on the CPU where `is_native`."""
        sources, view = self._inputs(part, camera)
        return DecodePass(part, sources, view, self._slot_tables(part))

    def is_native(self, part: LevelPart) -> bool:
        """True if native kernels decode a part: on the CPU in float32, without a fusion MLP."""
        here = self.offsets.device.type == "cpu" and self.offsets.dtype == torch.float32
        return here and "fuse_w1" not in part.networks

    def _inputs(self, part: LevelPart, camera: Camera) -> tuple[HeadInputs, ViewInput]:
        x, u = self.placed()
        layout = self.layout.first(part.grids)
        choice = (self.logits, self.codes, part.codebook)
        rows = self.visible(part, camera)
        sources = HeadInputs(rows, x, u, layout, self.table, *choice, self.residual)
        return sources, self.view_input(camera)

    def view_input(self, camera: Camera) -> ViewInput:
        """The heads' input for a camera, within the training cameras' bounds if those are known."""
        extent, seen = self.frame.extent, self.seen
        position: Point = tuple(camera.position.tolist())
        if seen is None:
            return ViewInput(position, extent)
        return ViewInput(seen.nearest(position), extent, seen.low, seen.high)

    def visible(self, part: LevelPart, camera: Camera) -> Tensor:
        """Anchors of a part that could touch the image, int64 [V]; see `visible_rows`."""
        return visible_rows(self._slot_tables(part), camera)

    def _slot_tables(self, part: LevelPart) -> SlotTables:
        x, _ = self.placed()
        return SlotTables(x, self.log_scales, self.offsets, part.mask, part.log_gain)


class DecodePass:
    """Decodes a part for one camera, and adds up what follows from gradients of its Gaussians."""

    def __init__(
        self, part: LevelPart, sources: HeadInputs, view: ViewInput, tables: SlotTables
    ) -> None:
        """Decode; see `AnchorModel.decode_pass`."""
        self.part, self.sources, self.tables = part, sources, tables
        self._weights = [part.networks[name] for name in WEIGHTS]
        self._heads = HeadsKernel(sources, view, self._weights)
        opacity, cov, color = self._heads.forward()
        self._slots = SlotsPass((opacity, cov, color), sources.rows, tables)
        *gaussians, slots, shown = self._slots.forward()
        made = Gaussians(*gaussians, focals=part.focals)
        self.decoded = Decoded(made, sources.rows, slots, shown)

    def backward(self, grads: Sequence[Tensor]) -> None:
        """Add to `grad` of every parameter that wants one, as autograd would.

        Args:
            grads: Of means, quaternions, scales, opacities and colours.
        """
        s, t = self.sources, self.tables
        heads, of_slots = self._slots.backward(
            grads, (t.log_scales.requires_grad, t.offsets.requires_grad)
        )
        wanted = [leaf.requires_grad for leaf in (s.table, s.logits, s.residual)]
        of_heads = self._heads.backward(heads, wanted)
        leaves = (t.log_scales, t.offsets, t.log_gain)
        inputs = (s.table, s.logits, s.codebook, s.residual, *self._weights)
        for leaf, grad in zip((*leaves, *inputs), (*of_slots, *of_heads), strict=True):
            if grad is None or not leaf.requires_grad or grad is leaf.grad:
                continue
            if leaf.grad is None:
                leaf.grad = grad
            else:
                leaf.grad += grad
