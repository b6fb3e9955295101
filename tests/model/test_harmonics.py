"""Colours of spherical harmonics."""

import torch

from gsynopsis.model.harmonics import harmonic_colors


def test_colours_without_harmonics_are_those_of_harmonics_that_are_zero() -> None:
    chance = torch.Generator().manual_seed(3)
    sh = 4 * torch.rand(500, 1, 3, generator=chance) - 2
    away = torch.randn(500, 3, generator=chance)
    padded = torch.cat([sh, torch.zeros(500, 15, 3)], dim=1)
    colors = harmonic_colors(sh, away)
    assert (colors == 0).any()
    assert torch.equal(colors, harmonic_colors(padded, away))
