"""What gaussforge writes from our Gaussians, it and others read back."""

import numpy as np
import pytest
import torch

from gsynopsis.formats.axes import half_turned
from gsynopsis.formats.writers.forge import VERSIONS, ForgeFormat, forge_bytes
from gsynopsis.model.bake import rotations
from gsynopsis.model.harmonics import harmonic_colors
from tests.formats.scattered import scattered

gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is not installed")


@pytest.mark.parametrize("name", list(VERSIONS))
def test_gaussians_come_back_as_well_as_the_format_holds_them(name: ForgeFormat) -> None:
    gaussians = scattered(300)
    data = forge_bytes(gaussians, name)
    read = gaussforge.GaussForge().read(data, "spz")
    assert "error" not in read
    means = np.frombuffer(read["data"]["positions"], np.float32).reshape(-1, 3)
    assert len(means) == 300
    means = means * [1, -1, -1]  # y is up there
    distances = np.abs(means[:, None] - gaussians.means[None]).max(axis=2)
    assert float(distances.min(axis=1).max()) < 0.02


@pytest.mark.parametrize(("name", "start"), [("spz", b"NGSP\x04"), ("spz3", b"\x1f\x8b")])
def test_versions_of_spz_are_told_by_their_first_bytes(name: ForgeFormat, start: bytes) -> None:
    assert forge_bytes(scattered(20), name).startswith(start)


def test_half_a_turn_moves_shapes_and_colours_together() -> None:
    gaussians = scattered(50)
    turned = half_turned(gaussians)
    turn = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    away = torch.tensor(gaussians.means)
    assert torch.equal(away @ turn, torch.tensor(turned.means))
    seen = harmonic_colors(torch.tensor(gaussians.sh), away)
    again = harmonic_colors(torch.tensor(turned.sh), away @ turn)
    assert torch.allclose(seen, again, atol=1e-5)
    axes = turn @ rotations(torch.tensor(gaussians.quaternions))
    assert torch.allclose(axes, rotations(torch.tensor(turned.quaternions)), atol=1e-5)
