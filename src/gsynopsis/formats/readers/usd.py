"""OpenUSD with the schema ParticleField3DGaussianSplat, read by the library usd-core.

The library runs in a process of its own, whose time and memory are bounded: on some damaged files
it loops for ever or asks for gigabytes.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Generator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gsynopsis.errors import InputError, MissingExtraError
from gsynopsis.formats.readers.base import SplatFile, check_count, cleaned
from gsynopsis.records import PlainGaussians

BEGINS = (b"PXR-", b"#usd")
"""First bytes of binary files and of text."""
ENDINGS = (".usd", ".usda", ".usdc", ".usdz")
"""The library goes by the ending."""
FILE_MAX = 1 << 33
SECONDS, BYTES = 45, 4 << 20
"""Most time by the clock; each so many bytes of the file may take another second."""
ALONE = {"PXR_WORK_THREAD_LIMIT": "1"}
"""Environment of the library: no threads, each of which would reserve memory."""


def read_usd(path: Path) -> SplatFile:
    """The Gaussians of all prims of a USD file that have the schema, in the world.

    Raises:
        InputError: it is damaged, refers to other files, or has no such prim.
        MissingExtraError: usd-core is not installed.
    """
    if find_spec("pxr") is None:
        raise MissingExtraError("usd-core", "usd")
    size = path.stat().st_size
    if size > FILE_MAX:
        raise InputError(path, found=f"{size:,} bytes", expected=f"at most {FILE_MAX:,}")
    with _named(path) as named, tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "splats.npz"
        line = [sys.executable, "-m", "gsynopsis.formats.readers.usd_child", str(named), str(out)]
        try:
            done = subprocess.run(
                line, capture_output=True, timeout=SECONDS + size // BYTES, env=os.environ | ALONE
            )
        except subprocess.TimeoutExpired as error:
            raise _damaged(path) from error
        if done.returncode == 1 and done.stdout.startswith(b"{"):
            raise InputError(path, **json.loads(done.stdout))
        if done.returncode or not out.is_file():
            raise _damaged(path)
        with np.load(out) as values:
            x, y, z = map(float, values["up"])
            names = PlainGaussians.__dataclass_fields__
            gaussians = PlainGaussians(**{name: values[name] for name in names})
    check_count(len(gaussians), path)
    return cleaned(SplatFile((gaussians,), up=(x, y, z), kind="USD"), path)


def _damaged(path: Path) -> InputError:
    return InputError(path, found="a file that usd-core cannot read", expected="a whole USD file")


@contextlib.contextmanager
def _named(path: Path) -> Generator[Path]:
    """The file under a name that the library takes for its own."""
    if path.suffix.lower() in ENDINGS:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "splats.usd"
        link.symlink_to(path.resolve())
        yield link
