"""The `.splat` of antimatter15's viewer: 32 bytes a Gaussian, no header, axes of 3DGS."""

from pathlib import Path

import numpy as np

from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.formats.readers.base import SplatFile, check_count, cleaned, logits_of
from gsynopsis.records import SH_0, PlainGaussians

ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("turn", "u1", 4)])
"""Scales as they are, colour and opacity from 0 to 255, w x y z around 128."""


def read_splat(path: Path) -> SplatFile:
    """The Gaussians of a `.splat` file.

    Raises:
        InputError: its length is not a multiple of 32 bytes, or values are impossible.
    """
    with open_regular(path) as file:
        size = file.seek(0, 2)
        if size % ROW.itemsize:
            expected = f"a multiple of {ROW.itemsize}"
            raise InputError(path, found=f"{size:,} bytes", expected=expected)
        check_count(size // ROW.itemsize, path)
        rows = np.memmap(file, ROW, "r")
    colors = rows["color"] / np.float32(255)
    first = ((colors[:, :3] - 0.5) / SH_0).astype(np.float32)
    gaussians = PlainGaussians(
        means=np.array(rows["mean"], np.float32),
        log_scales=np.log(rows["scale"]).astype(np.float32),
        quaternions=(rows["turn"].astype(np.float32) - 128) / np.float32(128),
        logits=logits_of(colors[:, 3]),
        sh=first[:, None],
    )
    return cleaned(SplatFile((gaussians,), kind="splat"), path)
