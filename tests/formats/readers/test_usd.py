"""USD back in: what we write, what others may, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.usd import usd_bytes
from tests.formats.scattered import scattered
from tests.formats.trees import HEIGHT, crown_of, tree

pytest.importorskip("pxr", reason="usd-core is not installed")


@pytest.mark.parametrize("name", ["a.usdc", "a.usd", "a.bin"])
def test_what_export_writes_comes_back_with_y_up(name: str, tmp_path: Path) -> None:
    g = scattered(30, degree=2)
    path = tmp_path / name
    path.write_bytes(usd_bytes(g))
    found = read_splats(path)
    assert found.kind == "USD" and found.up == (0, 1, 0)
    back = found.levels[0]
    assert np.allclose(back.means, g.means * [1, -1, -1], atol=1e-5)
    assert np.allclose(back.log_scales, g.log_scales, atol=1e-5)
    assert np.allclose(1 / (1 + np.exp(-back.logits)), 1 / (1 + np.exp(-g.logits)), atol=1e-6)
    assert back.sh.shape == g.sh.shape


def stage_at(path: Path, **values: Any) -> Any:
    """A file of three splats that another program might write."""
    from pxr import Gf, Usd, UsdGeom, UsdVol, Vt

    stage: Any = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, values.get("up", UsdGeom.Tokens.z))
    root = UsdGeom.Xform.Define(stage, "/World")
    UsdGeom.Xformable(root).AddTranslateOp().Set(Gf.Vec3d(0, 0, 5))
    UsdGeom.Xformable(root).AddScaleOp().Set(values.get("scale", Gf.Vec3f(2, 2, 2)))
    field: Any = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/World/Splats")
    half = Vt.Vec3hArray([Gf.Vec3h(1, 2, 3), Gf.Vec3h(0, 0, 0), Gf.Vec3h(0, 0, 1)])
    field.CreatePositionshAttr(half)
    field.CreateScalesAttr(Vt.Vec3fArray(3, Gf.Vec3f(0.5, 0.5, 0.5)))
    return stage


def test_half_floats_text_and_nodes_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    stage_at(path).Save()
    found = read_splats(path)
    assert found.up == (0, 0, 1)
    assert found.levels[0].means.tolist() == [[2, 4, 11], [0, 0, 5], [0, 0, 7]]
    assert np.allclose(found.levels[0].log_scales, 0, atol=1e-6)
    assert (found.levels[0].quaternions == [1, 0, 0, 0]).all() and not found.levels[0].sh.any()


def test_an_archive_is_read(tmp_path: Path) -> None:
    from pxr import UsdUtils

    (tmp_path / "a.usdc").write_bytes(usd_bytes(tree()))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "a.usdc"), str(tmp_path / "b.usdz"))
    found = read_splats(tmp_path / "b.usdz")
    crown = crown_of(found.levels[0].means.astype(np.float64), found.levels[0].sh)
    assert crown[1] == pytest.approx(HEIGHT, abs=0.05)


def test_a_file_that_refers_to_others_is_refused(tmp_path: Path) -> None:
    stage = stage_at(tmp_path / "a.usda")
    stage.GetPrimAtPath("/World").GetReferences().AddReference("/etc/secret.usd", "/X")
    stage.Save()
    with pytest.raises(InputError, match="flatten"):
        read_splats(tmp_path / "a.usda")


@pytest.mark.parametrize("text", ["#usda 1.0\n(", "#usda 1.0\n", "PXR-USDC" + "x" * 90])
def test_what_is_none_is_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.usd"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_splats(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_an_uneven_scale_and_a_short_column_are_refused(tmp_path: Path) -> None:
    from pxr import Gf, Vt

    stage_at(tmp_path / "a.usda", scale=Gf.Vec3f(1, 2, 1)).Save()
    with pytest.raises(InputError, match="unevenly"):
        read_splats(tmp_path / "a.usda")
    stage = stage_at(tmp_path / "b.usda")
    stage.GetPrimAtPath("/World/Splats").GetAttribute("scales").Set(Vt.Vec3fArray(2))
    stage.Save()
    with pytest.raises(InputError, match="scales: found 2, expected 3"):
        read_splats(tmp_path / "b.usda")
