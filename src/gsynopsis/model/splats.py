"""Splats of a file: Gaussians with values of their own, for the renderers (docs/format.md §5).

Letters: N splats of all levels, V of them that a camera could see, C coefficients of spherical
harmonics of each colour.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels
from gsynopsis.model.harmonics import harmonic_colors
from gsynopsis.model.tables import Decoded
from gsynopsis.model.training_focals import parse_focals
from gsynopsis.records import (
    FOCALS_NOTE,
    Float32,
    LevelSet,
    PlainGaussians,
    harmonics_of,
    positions,
)
from gsynopsis.render.base import NEAR_PLANE, Gaussians, TrainingFocals
from gsynopsis.scene.camera import Camera

SIGMAS = 3.0
"""A splat is left out if it ends before the image at this many standard deviations."""
CHUNK = 1 << 16
"""Splats that are looked at in one go."""


class SplatPart(nn.Module):
    """Parameters of one level: the mask of its splats, and its scale."""

    mask: Tensor  # [N, 1] bool
    gain: Tensor  # [3]

    def __init__(self, mask: Tensor, gain: Tensor, focals: TrainingFocals | None = None) -> None:
        """Takes the tensors over."""
        super().__init__()
        self.register_buffer("mask", mask)
        self.register_buffer("gain", gain)
        self.focals = focals

    def of_rows(self, rows: Tensor) -> "SplatPart":
        """A part that has these of all splats alone, int64 [n]."""
        mask = torch.zeros_like(self.mask)
        mask[rows] = True
        return SplatPart(mask, self.gain, self.focals)


class SplatModel(nn.Module):
    """N splats and which of them each level has, coarsest first.

    To a renderer it is an `AnchorModel` of one slot whose parts are `SplatPart`s.
    """

    means: Tensor  # [N, 3] world units
    quats: Tensor  # [N, 4] w x y z, unit length
    log_scales: Tensor  # [N, 3]
    opacities: Tensor  # [N] in [0, 1]
    sh: Tensor  # [N, C, 3]
    largest: Tensor  # [N] scale along the longest axis

    slots = 1
    """K."""

    def __init__(self, gaussians: PlainGaussians, parts: Sequence[SplatPart] = ()) -> None:
        """Shares the arrays.

        Args:
            gaussians: N of them.
            parts: Of the levels; none: one level that has all.
        """
        super().__init__()
        self.register_buffer("means", torch.from_numpy(gaussians.means))
        self.register_buffer("quats", torch.from_numpy(gaussians.quaternions))
        self.register_buffer("log_scales", torch.from_numpy(gaussians.log_scales))
        self.register_buffer("opacities", torch.from_numpy(gaussians.logits).sigmoid())
        self.register_buffer("sh", torch.from_numpy(gaussians.sh))
        self.register_buffer("largest", self.log_scales.amax(dim=1).exp())
        whole = SplatPart(torch.ones(len(gaussians), 1, dtype=torch.bool), torch.ones(3))
        self.parts = nn.ModuleList(parts or [whole])

    def __len__(self) -> int:
        return self.means.shape[0]

    def part(self, level: int) -> SplatPart:
        """The part of a level; -1 is the finest."""
        return self.parts[level]  # type: ignore[return-value]

    def decode(self, camera: Camera, level: int = -1) -> Gaussians:
        """The Gaussians of a level that a camera sees, ready for a renderer."""
        return self.decode_part(self.part(level), camera).gaussians

    def decode_level(self, level: int, camera: Camera) -> Decoded:
        """As `decode`, with where each Gaussian comes from."""
        return self.decode_part(self.part(level), camera)

    def decode_part(self, part: SplatPart, camera: Camera) -> Decoded:
        """The splats of a part as one camera sees them.

        Args:
            part: One of this model's parts, or a candidate for one; its mask says which splats.
            camera: Any camera.
        """
        with torch.no_grad():
            rows = self.visible(part, camera)
            means = self.means.index_select(0, rows)
            eye = torch.as_tensor(camera.position, dtype=means.dtype, device=means.device)
            gaussians = Gaussians(
                means,
                self.quats.index_select(0, rows),
                self.log_scales.index_select(0, rows).exp() * part.gain,
                self.opacities.index_select(0, rows),
                harmonic_colors(self.sh.index_select(0, rows), means - eye),
                focals=part.focals,
            )
        return Decoded(gaussians, rows, rows, gaussians.opacities[:, None])

    def visible(self, part: SplatPart, camera: Camera) -> Tensor:
        """Splats of a part that could touch the image, int64 [V] ascending."""
        rows = part.mask[:, 0].nonzero()[:, 0]
        p, largest = self.means, self.largest
        if len(rows) < len(self):
            p, largest = p.index_select(0, rows), largest.index_select(0, rows)
        w2c = torch.as_tensor(camera.w2c, dtype=p.dtype, device=p.device)
        most = SIGMAS * part.gain.max()
        lens = ((camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height))
        inside = torch.empty(len(rows), dtype=torch.bool, device=p.device)
        # A chunk's values stay in the processor's cache: two thirds of the time of all at once.
        for start in range(0, len(rows), CHUNK):
            own = slice(start, start + CHUNK)
            *places, z = torch.addmm(w2c[:3, 3:], w2c[:3, :3], p[own].T)
            reach, near = most * largest[own], z.clamp(min=NEAR_PLANE)
            seen = z >= NEAR_PLANE
            for across, (focal, center, size) in zip(places, lens, strict=True):
                # In units of 1 / z: to divide each splat would take as long as all the rest.
                # The Jacobian's clamp lets nothing grow by more than the image's own angle.
                at, margin = focal * across, (focal + size) * reach
                seen &= at + margin > near * -(center + SIGMAS)
                seen &= at - margin < near * (size - center + SIGMAS)
            inside[own] = seen
        return rows[inside]


FileModel = AnchorModel | SplatModel
"""Model of either kind of file, with anchors or with splats."""


def decoder_of(levels: LevelSet) -> FileModel:
    """A model that renders a decoded file; rows keep the file's order."""
    if levels.shared.degree is None:
        return model_from_levels(levels)
    count = len(levels.shared.lattice)
    focals = parse_focals(levels.meta.get(FOCALS_NOTE), len(levels.levels))
    parts: list[SplatPart] = []
    for number, level in enumerate(levels.levels):
        rows = torch.arange(count)
        mask = ((rows >= levels.first_shown(number)) & (rows < level.anchors))[:, None]
        parts.append(SplatPart(mask, torch.tensor(level.gain), focals[number] if focals else None))
    return SplatModel(plain_of(levels), parts)


def plain_of(levels: LevelSet) -> PlainGaussians:
    """The splats of all levels as Gaussians of other programs, without the levels' gains.

    Args:
        levels: With splats as rows.
    """
    shared = levels.shared
    assert shared.degree is not None
    red_green_blue = rgb_of(shared.residual[:, 4:])
    count = len(red_green_blue)
    rest = harmonics_of(shared, levels.levels).reshape(count, shared.harmonics // 3, 3)
    return PlainGaussians(
        means=positions(levels.frame, shared.lattice),
        log_scales=shared.log_scales.copy(),
        quaternions=quaternions_of(shared.residual[:, :3]),
        logits=shared.residual[:, 3].copy(),
        sh=np.concatenate([red_green_blue[:, None], rest], axis=1),
    )


def plain_level(levels: LevelSet, level: int) -> PlainGaussians:
    """The splats of one level as Gaussians of other programs.

    Args:
        levels: With splats as rows.
        level: 0 is the coarsest, -1 the finest.
    """
    own, found = levels.levels[level], plain_of(levels)
    rows = slice(levels.first_shown(level), own.anchors)
    return PlainGaussians(
        means=found.means[rows],
        log_scales=found.log_scales[rows] + np.log(own.gain),
        quaternions=found.quaternions[rows],
        logits=found.logits[rows],
        sh=found.sh[rows],
    )


def joined_gaussians(parts: Sequence[PlainGaussians]) -> PlainGaussians:
    """All Gaussians of some sets, whose harmonics have the same degree, in their order."""
    names = ("means", "log_scales", "quaternions", "logits", "sh")
    means, log_scales, quaternions, logits, sh = (
        np.concatenate([getattr(part, name) for part in parts]) for name in names
    )
    return PlainGaussians(means, log_scales, quaternions, logits, sh)


def quaternions_of(rotations: Float32) -> Float32:
    """Unit quaternions w x y z, [N, 4], of axes times tangents of a quarter of the angle [N, 3].

    Not finite where a tangent's square overflows: renderers leave such a splat out (format.md).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.square(rotations).sum(axis=1, keepdims=True)
        return np.concatenate([1 - square, 2 * rotations], axis=1) / (1 + square)


def rotations_of(quaternions: NDArray[np.floating]) -> Float32:
    """The inverse of `quaternions_of`, of any quaternions but 0; within the unit ball."""
    q = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    q = np.where(q[:, :1] < 0, -q, q)
    return (q[:, 1:] / (1 + q[:, :1])).astype(np.float32)


def rgb_of(colors: Float32) -> Float32:
    """Red, green, blue of Y, Co, Cg, both [N, 3]."""
    y, orange, green = colors.T
    return np.stack([y - green + orange, y + green, y - green - orange], axis=1)


def ycocg_of(rgb: Float32) -> Float32:
    """The inverse of `rgb_of`."""
    red, green, blue = rgb.T
    middle = (red + blue) / 2
    return np.stack([(middle + green) / 2, (red - blue) / 2, (green - middle) / 2], axis=1)
