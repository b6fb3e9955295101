"""Builds a prototype's `raster.cpp` in a temporary folder and wraps it for `raster.py`."""

import importlib.util
import subprocess
import sysconfig
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import nanobind
import numpy as np

from benchmarks.train.raster_scene import ArrayScene


def load_prototype(
    folder: Path, scene: ArrayScene, threads: int
) -> Callable[[], tuple[tuple[float, float, float], dict[str, float]]]:
    """One round of the prototype, 16 × 16 tiles, on the same scene and threads."""
    with tempfile.TemporaryDirectory() as build:
        module = _build(folder / "raster.cpp", Path(build))
    module.set_threads(threads)
    raster = module.Raster16()
    image = np.empty((scene.height, scene.width, 3), np.float32)
    left = np.empty((scene.height, scene.width), np.float32)
    grads = [np.empty_like(a) for a in (*scene.shape_arrays(), scene.colors)]
    rotation, translation = np.eye(3, dtype=np.float32), np.zeros(3, np.float32)
    focal, cx, cy = scene.focal, scene.width / 2, scene.height / 2

    def one_round() -> tuple[tuple[float, float, float], dict[str, float]]:
        arrays = scene.shape_arrays()
        start = time.perf_counter()
        raster.project(
            *arrays, scene.colors, rotation, translation, focal, focal, cx, cy, scene.width,
            scene.height,
        )  # fmt: skip
        raster.forward(scene.background, image, left)
        middle = time.perf_counter()
        raster.backward(image, scene.grad_image, *arrays, *grads)
        end = time.perf_counter()
        names = {"project": "t_proj", "sort": "t_sort", "bin": "t_bin"}
        names |= {"blend_backward": "t_rb", "project_backward": "t_pb"}
        return (start, middle, end), {k: 1e3 * getattr(raster, v) for k, v in names.items()}

    return one_round


def _build(source: Path, build: Path) -> ModuleType:
    """Compiles for this very CPU, as the prototype's own script does."""
    root = Path(nanobind.__file__).parent
    target = build / f"raster_cpp{sysconfig.get_config_var('EXT_SUFFIX')}"
    includes = [f"-I{sysconfig.get_paths()['include']}", f"-I{root / 'include'}"]
    common = ["g++", "-std=c++17", "-fPIC", "-fvisibility=hidden", "-fno-strict-aliasing"]
    runtime, raster = build / "nanobind.o", build / "raster.o"
    subprocess.run(
        [*common, "-Os", *includes, f"-I{root / 'ext' / 'robin_map' / 'include'}", "-c",
         str(root / "src" / "nb_combined.cpp"), "-o", str(runtime)], check=True
    )  # fmt: skip
    subprocess.run(
        [*common, "-O3", "-march=native", "-ffast-math", "-fopenmp", *includes, "-c",
         str(source), "-o", str(raster)], check=True
    )  # fmt: skip
    subprocess.run(
        ["g++", "-shared", "-fopenmp", str(raster), str(runtime), "-o", str(target)], check=True
    )
    spec = importlib.util.spec_from_file_location("raster_cpp", target)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
