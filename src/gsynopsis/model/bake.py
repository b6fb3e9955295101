"""Baking: a level of the anchor model as plain Gaussians, for programs that know no heads.

What depends on the view is averaged over the cameras that see a slot, each with the slot's blend
weight there: the sum of alpha times transmittance over the picture. Colours become spherical
harmonics by least squares (methods.md §2.14, ours).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.harmonics import harmonic_basis
from gsynopsis.model.tables import Decoded
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import ALPHA_MAX, DILATION, Gaussians, Renderer
from gsynopsis.render.measures import blend_weights
from gsynopsis.scene.camera import Camera

MIDDLE = 0.5
"""Added to what the harmonics give (3DGS)."""
RIDGE = 1e-4
"""Penalty on a coefficient of degree l, in units of its Gaussian's weight times (l (l + 1))² (ours:
without one, colours run away in directions that no camera saw)."""
CHUNK = 1 << 14
"""Gaussians whose harmonics are solved for at once: 32 MiB of matrices."""
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Entries of a symmetric matrix that are kept."""


@dataclass(frozen=True)
class Baking:
    """Settings of baking a level.

    Attributes:
        degree: Degree of the spherical harmonics, 0 to 3.
        antialiased: Training's dilation becomes a part of the Gaussians, and programs are to
            render them antialiased, as those of Mip-Splatting: then they look the same at every
            image size. Else they are those of 3DGS, which look right only at the resolution of
            training.
    """

    degree: int = 3
    antialiased: bool = False


@one_torch_thread()
def bake(
    model: AnchorModel,
    level: int,
    cameras: Sequence[Camera],
    renderer: Renderer,
    baking: Baking,
    tick: Callable[[int, int], None] | None = None,
) -> PlainGaussians:
    """A level as plain Gaussians, in the order of its slots; none where no camera sees any.

    Args:
        model: On the renderer's device; not modified.
        level: 0 is the coarsest, -1 the finest.
        cameras: Viewpoints to bake for, at least one; those of training are best.
        renderer: Gives blend weights.
        baking: Settings.
        tick: Called with cameras done and cameras in all.
    """
    part = model.part(level)
    live = part.mask.reshape(-1).nonzero()[:, 0]
    places = torch.full((part.mask.numel(),), -1, dtype=torch.int64, device=live.device)
    places[live] = torch.arange(len(live), device=live.device)
    sums = _Sums(len(live), baking.degree, live.device)
    with torch.no_grad():
        for done, camera in enumerate(cameras, start=1):
            decoded = model.decode_part(part, camera)
            weights = blend_weights(renderer, decoded.gaussians, camera)
            sums.add(decoded, places, weights, camera, baking.antialiased)
            if tick:
                tick(done, len(cameras))
        return sums.gaussians()


class _Sums:
    """Weighted sums over cameras for each live slot, S of them."""

    def __init__(self, slots: int, degree: int, device: torch.device) -> None:
        coefficients = (degree + 1) ** 2
        rows, columns = torch.triu_indices(coefficients, coefficients, device=device)
        self.rows, self.columns = rows, columns
        self.weight = torch.zeros(slots, device=device)
        self.opacity = torch.zeros(slots, device=device)
        self.means = torch.zeros(slots, 3, device=device)
        self.shape = torch.zeros(slots, len(UPPER), device=device)
        self.gram = torch.zeros(slots, len(rows), device=device)
        self.moment = torch.zeros(slots, coefficients, 3, device=device)

    def add(
        self,
        decoded: Decoded,
        places: Tensor,
        weights: Tensor,
        camera: Camera,
        antialiased: bool,
    ) -> None:
        """One camera's view, with its blend weights [G]."""
        g, seen = decoded.gaussians, weights > 0
        slots, w = places[decoded.slots[seen]], weights[seen]
        means = g.means[seen]
        own = _own_dilation(means, g, camera) if antialiased else torch.zeros_like(w)
        eye = torch.as_tensor(camera.position, dtype=means.dtype, device=means.device)
        basis = harmonic_basis(functional.normalize(means - eye, dim=1), self.moment.shape[1])
        shape = log_covariances(g.quats[seen], g.scales[seen], own)
        # A slot comes once per camera, so that rows are added to in place.
        self.weight[slots] += w
        self.opacity[slots] += w * g.opacities[seen]
        self.means[slots] = means
        self.shape[slots] += w[:, None] * shape
        self.gram[slots] += w[:, None] * basis[:, self.rows] * basis[:, self.columns]
        self.moment[slots] += (w[:, None] * basis)[:, :, None] * (g.colors[seen] - MIDDLE)[:, None]

    def gaussians(self) -> PlainGaussians:
        """Gaussians from the accumulated sums, without slots that no camera saw."""
        seen = (self.weight > 0).nonzero()[:, 0]
        weight = self.weight[seen]
        quats, log_scales = from_log_covariances(self.shape[seen] / weight[:, None])
        opacity = (self.opacity[seen] / weight).clamp(max=ALPHA_MAX)
        pieces = [self._harmonics(rows) for rows in seen.split(CHUNK)]
        sh = torch.cat(pieces) if pieces else self.moment[seen]
        values = (self.means[seen], log_scales, quats, opacity.logit(), sh)
        return PlainGaussians(*(v.float().cpu().numpy() for v in values))

    def _harmonics(self, rows: Tensor) -> Tensor:
        """Coefficients of least squares with a ridge, [n, C, 3]."""
        coefficients = self.moment.shape[1]
        degrees = torch.arange(coefficients, device=rows.device).double().sqrt().floor()
        penalty = RIDGE * (degrees * (degrees + 1)).square()
        gram = torch.zeros(len(rows), coefficients, coefficients).double().to(rows.device)
        gram[:, self.rows, self.columns] = self.gram[rows].double()
        gram[:, self.columns, self.rows] = self.gram[rows].double()
        gram += torch.diag_embed(self.weight[rows, None].double() * (penalty + 1e-9))
        return torch.linalg.solve(gram, self.moment[rows].double())


def _own_dilation(means: Tensor, gaussians: Gaussians, camera: Camera) -> Tensor:
    """Training's dilation in the world at each Gaussian, square world units [n]."""
    w2c = torch.as_tensor(camera.w2c, dtype=means.dtype, device=means.device)
    here = camera.focal_length
    shortest, longest = gaussians.focals or (here, here)
    depth = means @ w2c[2, :3] + w2c[2, 3]
    return DILATION * (depth / min(max(here, shortest), longest)).square()


def log_covariances(quats: Tensor, scales: Tensor, added: Tensor) -> Tensor:
    """Matrix logarithms of covariances, their upper entries row by row, [n, 6].

    The mean of such logarithms is that of log-Euclidean geometry: it knows neither signs of
    quaternions nor the order of axes, and does not swell where shapes differ.

    Args:
        quats: w x y z, of any length above 0, [n, 4].
        scales: Standard deviations, world units, > 0, [n, 3].
        added: To every variance, square world units, [n].
    """
    axes = rotations(quats)
    # The square of what is flatter than 1e-19 is 0 in float32, whose logarithm no matrix has.
    logs = (scales.square() + added[:, None]).clamp(min=torch.finfo(scales.dtype).tiny).log()
    full = (axes * logs[:, None, :]) @ axes.transpose(1, 2)
    return torch.stack([full[:, i, j] for i, j in UPPER], dim=1)


def from_log_covariances(upper: Tensor) -> tuple[Tensor, Tensor]:
    """The inverse of `log_covariances`: quaternions [n, 4], logarithms of scales [n, 3]."""
    full = upper.new_zeros(len(upper), 3, 3, dtype=torch.float64)
    for column, (i, j) in enumerate(UPPER):
        full[:, i, j] = full[:, j, i] = upper[:, column].double()
    logs, axes = torch.linalg.eigh(full)
    axes[:, :, 0] *= torch.linalg.det(axes).sign()[:, None]
    return quaternions(axes).to(upper.dtype), (0.5 * logs).to(upper.dtype)


def rotations(quats: Tensor) -> Tensor:
    """Rotation matrices of quaternions w x y z, [n, 3, 3]."""
    w, x, y, z = functional.normalize(quats, dim=1).unbind(dim=1)
    entries = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(entries, dim=1).view(-1, 3, 3)


def quaternions(matrices: Tensor) -> Tensor:
    """Unit quaternions w x y z of rotation matrices [n, 3, 3], w ≥ 0: [n, 4].

    Each is a row of the matrix 4 q qᵀ, whose longest row is the most exact.
    """
    m = matrices
    trace = m.diagonal(dim1=1, dim2=2).sum(dim=1)
    products = m.new_zeros(len(m), 4, 4)
    products[:, 0, 0] = 1 + trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        products[:, i + 1, i + 1] = 1 + 2 * m[:, i, i] - trace
        products[:, 0, i + 1] = products[:, i + 1, 0] = m[:, k, j] - m[:, j, k]
        products[:, j + 1, k + 1] = products[:, k + 1, j + 1] = m[:, j, k] + m[:, k, j]
    best = products.diagonal(dim1=1, dim2=2).argmax(dim=1)
    quats = functional.normalize(products[torch.arange(len(m)), best], dim=1)
    return torch.where(quats[:, :1] < 0, -quats, quats)
