"""Spherical harmonics as 3DGS has them: its order, signs and constants (docs/format.md §5)."""

import torch
from torch import Tensor

from gsynopsis.records import SH_0, SH_1, SH_2, SH_3


def harmonic_colors(sh: Tensor, away: Tensor) -> Tensor:
    """Colours [V, 3] of spherical harmonics [V, C, 3] seen along `away`, of any length [V, 3]."""
    if sh.shape[1] == 1:  # The same from everywhere, and many files have no more.
        return (SH_0 * sh[:, 0] + 0.5).clamp(min=0)
    d = away / away.norm(dim=1, keepdim=True).clamp(min=1e-8)
    basis = harmonic_basis(d, sh.shape[1])
    return (torch.einsum("vc,vck->vk", basis, sh) + 0.5).clamp(min=0)


def harmonic_basis(d: Tensor, count: int) -> Tensor:
    """The first `count` spherical harmonics of 3DGS at unit directions [V, 3], [V, count]."""
    x, y, z = d.unbind(dim=1)
    found = [torch.full_like(x, SH_0)]
    if count > 1:
        found += [-SH_1 * y, SH_1 * z, -SH_1 * x]
    if count > 4:
        xx, yy, zz = x * x, y * y, z * z
        a, b, c = SH_2
        found += [a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, c * (xx - yy)]
        if count > 9:
            a, b, c, e, f = SH_3
            found += [
                -a * y * (3 * xx - yy),
                b * x * y * z,
                -c * y * (4 * zz - xx - yy),
                e * z * (2 * zz - 3 * xx - 3 * yy),
                -c * x * (4 * zz - xx - yy),
                f * z * (xx - yy),
                -a * x * (xx - 3 * yy),
            ]
    return torch.stack(found, dim=1)
