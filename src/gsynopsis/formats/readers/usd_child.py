"""A process that reads one USD file through the library usd-core; see `usd`.

Only the file itself is read: one that refers to others is refused, for they may lie anywhere.
"""

import json
import re
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.formats.axes import UP, Up
from gsynopsis.formats.readers.base import (
    check_count,
    check_ratio,
    joined,
    logits_of,
    shown,
)
from gsynopsis.formats.readers.glb import moved_by
from gsynopsis.records import HARMONICS, SH_0, Float32, PlainGaussians

SCHEMA = "ParticleField3DGaussianSplat"
EXPECTED = f"USD with {SCHEMA}"
PRIMS_MAX = 10_000
CPU_SECONDS, CPU_BYTES = 8, 20 << 20
"""Most time of the processor; each so many bytes of the file may take another second."""
MEMORY, MEMORY_TIMES = 1 << 29, 10
"""Most memory, bytes; each byte of the file may take so many more."""
HARMONIC = "radiance:sphericalHarmonics"


def main() -> int:
    """Read the file that is named first into that which is named second, or print what is wrong."""
    source, out = map(Path, sys.argv[1:3])
    try:
        gaussians, up = _read(source)
    except InputError as error:
        said = {"field": error.field, "advice": error.advice}
        said |= {"found": str(error.found), "expected": str(error.expected)}
        print(json.dumps({key: value for key, value in said.items() if value}))
        return 1
    np.savez(out, up=up, **vars(gaussians))
    return 0


def _limit(size: int) -> None:
    """Bound time and memory by the file's bytes: damaged ones loop, or ask for gigabytes."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows: the parent's clock alone
        return
    most = {resource.RLIMIT_CPU: CPU_SECONDS + size // CPU_BYTES}
    with suppress(OSError):  # macOS does not tell what is taken already, and bounds no memory
        taken = re.search(r"VmData:\s*(\d+) kB", Path("/proc/self/status").read_text())
        if taken:
            bound = int(taken[1]) * 1024 + MEMORY + MEMORY_TIMES * size
            most[resource.RLIMIT_DATA] = bound
    for kind, soft in most.items():
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (soft if hard < 0 else min(soft, hard), hard))


def _read(path: Path) -> tuple[PlainGaussians, Up]:
    sdf, usd, geom = (import_module(f"pxr.{name}") for name in ("Sdf", "Usd", "UsdGeom"))
    _limit(path.stat().st_size)
    try:
        layer: Any = sdf.Layer.OpenAsAnonymous(str(path))
        _check_alone(layer, path)
        stage: Any = usd.Stage.Open(layer)
        up: Up = UP if geom.GetStageUpAxis(stage) == "Y" else (0.0, 0.0, 1.0)
        return _gaussians(stage, geom, path), up
    except (RuntimeError, TypeError, ValueError, AttributeError, MemoryError) as error:
        # The library's own errors are RuntimeErrors of several lines.
        found = shown((str(error).strip() or type(error).__name__).splitlines()[0])
        raise InputError(path, found=found, expected=EXPECTED) from error


def _check_alone(layer: Any, path: Path) -> None:
    if layer is None:
        raise InputError(path, found="nothing that the library reads", expected=EXPECTED)
    others = [*layer.GetCompositionAssetDependencies()]
    if others:
        advice = "flatten it (usdcat --flatten)"
        found = f"a reference to {shown(others[0])}"
        raise InputError(path, found=found, expected="one file alone", advice=advice)


def _gaussians(stage: Any, geom: Any, path: Path) -> PlainGaussians:
    cache, parts = geom.XformCache(), list[PlainGaussians]()
    total = seen = 0
    for prim in stage.Traverse():
        seen += 1
        if seen > PRIMS_MAX:
            raise ValueError(f"more than {PRIMS_MAX:,} prims")
        if prim.GetTypeName() != SCHEMA:
            continue
        part = _primitive(prim, path)
        total += len(part)
        check_count(total, path)
        world = np.array(cache.GetLocalToWorldTransform(prim), np.float64).T
        parts.append(moved_by(part, world))
    if not parts:
        raise InputError(path, found=f"no prim of the type {SCHEMA}", expected=EXPECTED)
    check_ratio(total, path.stat().st_size, path)
    return joined(parts)


def _primitive(prim: Any, path: Path) -> PlainGaussians:
    means = _column(prim, "positions", 3)
    if means is None or not len(means):
        raise InputError(path, "positions", found="none", expected="at least one")
    count = len(means)

    def column(name: str, width: int, usual: tuple[float, ...]) -> Float32:
        found = _column(prim, name, width)
        if found is None:
            return np.tile(np.array(usual, np.float32), (count, 1))
        if len(found) != count:
            raise InputError(path, name, found=f"{len(found):,}", expected=f"{count:,}")
        return found

    scales = column("scales", 3, (1.0, 1.0, 1.0))
    with np.errstate(all="ignore"):
        return PlainGaussians(
            means=means,
            log_scales=np.log(scales),
            quaternions=np.roll(column("orientations", 4, (0.0, 0.0, 0.0, 1.0)), 1, axis=1),
            logits=logits_of(column("opacities", 1, (1.0,))[:, 0].astype(np.float64)),
            sh=_harmonics(prim, count, path),
        )


def _harmonics(prim: Any, count: int, path: Path) -> Float32:
    """Coefficients [count, C, 3]; without any those of the prim's colour, else grey."""
    values = _column(prim, f"{HARMONIC}Coefficients", 3)
    if values is None or not len(values):
        color = _column(prim, "primvars:displayColor", 3)
        if color is None or len(color) not in (1, count):
            return np.zeros((count, 1, 3), np.float32)
        first = ((color - 0.5) / SH_0).astype(np.float32)
        return np.broadcast_to(first[:, None], (count, 1, 3)).copy()
    width = len(values) // count
    if len(values) % count or 3 * width - 3 not in HARMONICS:
        expected = f"{', '.join(str(1 + n // 3) for n in HARMONICS)} for each of {count:,} splats"
        raise InputError(path, "harmonics", found=f"{len(values):,}", expected=expected)
    return values.reshape(count, width, 3)


def _column(prim: Any, name: str, width: int) -> Float32 | None:
    """An attribute's values [count, width], of quaternions x y z w; None: it has none."""
    for each in (name, f"{name}h"):
        attribute = prim.GetAttribute(each)
        value: Any = attribute.Get() if attribute and attribute.HasAuthoredValue() else None
        if value is not None:
            found: NDArray[Any] = np.array(value)
            return found.astype(np.float32).reshape(-1, width)
    return None


if __name__ == "__main__":
    sys.exit(main())
