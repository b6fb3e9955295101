"""Other programs that read a file of splats and return its Gaussians.

None of it goes through our readers, but for the plain PLY that splat-transform and gaussforge give.
"""

import json
import subprocess
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.viewer.node import NODE
from gsynopsis.formats.readers.ply import read_ply
from gsynopsis.records import PlainGaussians

HERE = Path(__file__).parent
MODULES = HERE / "node_modules"
FORGE_NAMES = {
    "ply": "ply",
    "compressed-ply": "compressed.ply",
    "spz": "spz",
    "spz3": "spz",
    "sog": "sog",
}
"""Names of formats in gaussforge, of those that it reads."""


def missing(reader: str) -> str:
    """Package that a reader lacks to run here; empty if none."""
    modules = {"gaussforge": "gaussforge", "gsply": "gsply", "usd-core": "pxr"}
    if reader in modules:
        return "" if find_spec(modules[reader]) else f"{reader} (pip)"
    if NODE is None:
        return "node"
    package = {"splat-transform": "@playcanvas/splat-transform"}.get(reader, "gltf-validator")
    return "" if (MODULES / package).is_dir() else f"{package} (npm ci in benchmarks/interop)"


def splat_transform(*words: object) -> subprocess.CompletedProcess[str]:
    """A finished run of splat-transform, with its output."""
    cli = MODULES / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
    # -g cpu: it looks for a GPU otherwise, which none of this needs.
    command = [NODE, cli, "-q", "-w", "-g", "cpu", *words]
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=300)


def by_splat_transform(path: Path, folder: Path) -> PlainGaussians:
    """Gaussians as read by @playcanvas/splat-transform; the finest LOD of a streamed SOG."""
    out = folder / "splat_transform.ply"
    finest = ["-L", "0"] if path.name == "lod-meta.json" else []
    done = splat_transform(path, *finest, out)
    if done.returncode or not out.is_file():
        raise RuntimeError((done.stderr or done.stdout).strip()[-300:] or "nothing written")
    return read_ply(out).levels[-1]


def by_gaussforge(path: Path, name: str, folder: Path) -> PlainGaussians:
    """Gaussians as read by the library gaussforge."""
    forge: Any = import_module("gaussforge").GaussForge()
    made = forge.convert(path.read_bytes(), FORGE_NAMES[name], "ply")
    if "error" in made:
        raise RuntimeError(str(made["error"]))
    out = folder / "gaussforge.ply"
    out.write_bytes(bytes(made["data"]))
    return read_ply(out).levels[-1]


def by_gsply(path: Path, name: str) -> PlainGaussians:
    """Gaussians as read by the library gsply."""
    gsply: Any = import_module("gsply")
    data = gsply.read_spz(str(path)) if name.startswith("spz") else gsply.plyread(str(path))
    count = len(data.means)
    rest = np.asarray(data.shN if data.shN is not None else np.zeros((count, 0, 3)))
    first = np.asarray(data.sh0).reshape(count, 1, 3)
    return PlainGaussians(
        np.asarray(data.means, np.float32),
        np.asarray(data.scales, np.float32),
        np.asarray(data.quats, np.float32),
        np.asarray(data.opacities, np.float32).reshape(count),
        np.concatenate([first, rest.reshape(count, -1, 3)], axis=1).astype(np.float32),
    )


def by_usd(path: Path) -> PlainGaussians:
    """The first prim of Gaussians as read by usd-core, in the prim's own coordinates."""
    usd: Any = import_module("pxr.Usd")
    vol: Any = import_module("pxr.UsdVol")
    stage = usd.Stage.Open(str(path))
    prims = [p for p in stage.Traverse() if p.IsA(vol.ParticleField3DGaussianSplat)]
    field = vol.ParticleField3DGaussianSplat(prims[0])
    means = np.array(field.GetPositionsAttr().Get(), np.float32)
    turns = [(q.GetReal(), *q.GetImaginary()) for q in field.GetOrientationsAttr().Get()]
    opacities = np.clip(np.array(field.GetOpacitiesAttr().Get(), np.float64), 1e-7, 1 - 1e-7)
    harmonics = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(), np.float32)
    return PlainGaussians(
        means,
        np.log(np.array(field.GetScalesAttr().Get(), np.float32)),
        np.array(turns, np.float32),
        np.log(opacities / (1 - opacities)).astype(np.float32),
        harmonics.reshape(len(means), -1, 3),
    )


def validated(path: Path) -> dict[str, Any]:
    """The report of Khronos's glTF-Validator on a GLB."""
    command = [str(NODE), str(HERE / "validate.mjs"), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    if done.returncode:
        raise RuntimeError(done.stderr.strip()[-300:])
    return json.loads(done.stdout)
