"""Photos in, one progressive 3D Gaussian splatting file out.

    import gsynopsis as gs

    scene = gs.load_scene("photos")
    run = gs.train(scene, gs.resolve("standard", scene), "runs/photos")
    with run.open() as file:
        file.render(level=0).save("coarse.png")

Names are loaded when they are first used: `open`, `check` and `cut` of files need no PyTorch.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

# PyTorch's idle threads spin if this is not set before it loads, and take the processors from all
# else that runs.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
"""This version, as `pip` knows it.

Examples:
    >>> gs.__version__.count(".")
    2
"""

if TYPE_CHECKING:
    from gsynopsis.config import Recipe
    from gsynopsis.errors import FormatError, GsynopsisError, InputError
    from gsynopsis.jobs.evaluate import evaluate
    from gsynopsis.jobs.pack import pack
    from gsynopsis.jobs.resolve import resolve
    from gsynopsis.jobs.train import train
    from gsynopsis.jobs.unfold import unfold
    from gsynopsis.runs.folder import Run
    from gsynopsis.runs.gsyn_file import File, Splats
    from gsynopsis.runs.open import check, cut
    from gsynopsis.runs.open import open_file as open
    from gsynopsis.scene.camera import Camera
    from gsynopsis.scene.load import load_scene
    from gsynopsis.scene.scene import Scene
    from gsynopsis.synthetic.make_scene import make_scene

_PLACES = {
    "Camera": "scene.camera",
    "File": "runs.gsyn_file",
    "FormatError": "errors",
    "GsynopsisError": "errors",
    "InputError": "errors",
    "Recipe": "config",
    "Run": "runs.folder",
    "Scene": "scene.scene",
    "Splats": "runs.gsyn_file",
    "check": "runs.open",
    "cut": "runs.open",
    "evaluate": "jobs.evaluate",
    "load_scene": "scene.load",
    "make_scene": "synthetic.make_scene",
    "open": "runs.open:open_file",
    "pack": "jobs.pack",
    "resolve": "jobs.resolve",
    "train": "jobs.train",
    "unfold": "jobs.unfold",
}

__all__ = [
    "Camera",
    "File",
    "FormatError",
    "GsynopsisError",
    "InputError",
    "Recipe",
    "Run",
    "Scene",
    "Splats",
    "__version__",
    "check",
    "cut",
    "evaluate",
    "load_scene",
    "make_scene",
    "open",
    "pack",
    "resolve",
    "train",
    "unfold",
]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'gsynopsis' has no attribute {name!r}")
    module, _, called = _PLACES[name].partition(":")
    value = getattr(import_module(f"gsynopsis.{module}"), called or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
