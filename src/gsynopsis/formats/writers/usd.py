"""OpenUSD with the schema ParticleField3DGaussianSplat, through the library usd-core."""

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gsynopsis.errors import MissingExtraError
from gsynopsis.records import PlainGaussians

PRIM = "/Splats"


def usd_bytes(gaussians: PlainGaussians) -> bytes:
    """A binary USD file (crate) of one prim; y points up after half a turn about x.

    Args:
        gaussians: Any number.

    Raises:
        MissingExtraError: usd-core is not installed.
    """
    try:
        # Its modules have no types that a checker could read.
        gf, usd, geom, vol, vt = (
            import_module(f"pxr.{name}") for name in ("Gf", "Usd", "UsdGeom", "UsdVol", "Vt")
        )
    except ModuleNotFoundError as error:
        raise MissingExtraError("usd-core", "usd") from error
    norms = np.linalg.norm(gaussians.quaternions, axis=1, keepdims=True)
    turned = gaussians.quaternions / norms
    turns = [gf.Quatf(*row) for row in turned.tolist()]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "splats.usdc"
        stage: Any = usd.Stage.CreateNew(str(path))
        geom.SetStageUpAxis(stage, geom.Tokens.y)
        field: Any = vol.ParticleField3DGaussianSplat.Define(stage, PRIM)
        stage.SetDefaultPrim(field.GetPrim())
        geom.Xformable(field.GetPrim()).AddRotateXOp().Set(180.0)
        field.CreatePositionsAttr(_vectors(vt, gaussians.means))
        field.CreateOrientationsAttr(vt.QuatfArray(turns))
        field.CreateScalesAttr(_vectors(vt, np.exp(gaussians.log_scales)))
        opacities = 1 / (1 + np.exp(-gaussians.logits))
        field.CreateOpacitiesAttr(vt.FloatArray.FromNumpy(opacities.astype(np.float32)))
        field.CreateRadianceSphericalHarmonicsDegreeAttr(gaussians.degree)
        harmonics = gaussians.sh.reshape(-1, 3)
        field.CreateRadianceSphericalHarmonicsCoefficientsAttr(_vectors(vt, harmonics))
        if len(gaussians):
            ends = np.stack([gaussians.means.min(axis=0), gaussians.means.max(axis=0)])
            field.CreateExtentAttr(_vectors(vt, ends))
        stage.Save()
        return path.read_bytes()


def _vectors(vt: Any, values: np.ndarray) -> Any:
    return vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))
