"""USD files open with usd-core and hold every value."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis.formats.writers.usd import PRIM, usd_bytes
from tests.formats.scattered import scattered

pytest.importorskip("pxr", reason="usd-core is not installed")


def test_usd_core_reads_every_value(tmp_path: Path) -> None:
    from pxr import Usd, UsdVol

    g = scattered(30, degree=2)
    path = tmp_path / "splats.usdc"
    path.write_bytes(usd_bytes(g))
    stage = Usd.Stage.Open(str(path))
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath(PRIM))
    assert field and stage.GetDefaultPrim().GetTypeName() == "ParticleField3DGaussianSplat"
    assert np.array_equal(np.array(field.GetPositionsAttr().Get()), g.means)
    assert np.allclose(np.log(np.array(field.GetScalesAttr().Get())), g.log_scales, atol=1e-6)
    assert field.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 2
    harmonics = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    assert np.array_equal(harmonics.reshape(30, 9, 3), g.sh)
    turn = field.GetOrientationsAttr().Get()[4]
    found = np.array([turn.GetReal(), *turn.GetImaginary()])
    assert np.allclose(found, g.quaternions[4] / np.linalg.norm(g.quaternions[4]), atol=1e-6)
