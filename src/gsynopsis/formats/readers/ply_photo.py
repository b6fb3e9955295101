"""The photo's camera in PLY files of SHARP (Apple), which makes splats of one photo.

After the splats stand elements of one property of their own name: `intrinsic`, a matrix of nine
numbers in pixels; `image_size`, width and height; `extrinsic`, the world-to-camera matrix of
sixteen (github.com/apple/ml-sharp).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.readers.base import PhotoCamera

PHOTO = ("intrinsic", "image_size", "extrinsic")
LARGEST = 1 << 16
"""Longest side of a photo, pixels."""
RIGID = 1e-3
"""Largest difference of RᵀR from the identity in any element."""
Rows = Mapping[str, NDArray[Any]]


def photo_camera(rows: Rows) -> tuple[PhotoCamera | None, list[str]]:
    """The camera of a file's photo, and a line where there is one that is not understood.

    Args:
        rows: Elements of the file by name, structured arrays.
    """
    if "intrinsic" not in rows:
        return None, []
    values = {name: _values(rows, name) for name in PHOTO}
    if "extrinsic" not in rows:
        values["extrinsic"] = np.eye(4).ravel()
    sizes = tuple(values[name].size for name in PHOTO)
    if sizes == (9, 2, 16):
        matrix, w2c = values["intrinsic"].reshape(3, 3), values["extrinsic"].reshape(4, 4)
        width, height = values["image_size"].tolist()
        lens = matrix[0, 0] > 0 and matrix[1, 1] > 0
        sized = 1 <= width <= LARGEST and 1 <= height <= LARGEST
        turn = w2c[:3, :3]
        rigid = np.abs(turn.T @ turn - np.eye(3)).max() < RIGID and np.linalg.det(turn) > 0
        if lens and sized and rigid and np.isfinite([*matrix.ravel(), *w2c.ravel()]).all():
            return PhotoCamera(int(width), int(height), matrix, w2c), []
    counts = ", ".join(f"{size} of {name}" for size, name in zip(sizes, PHOTO, strict=True))
    return None, [f"not understood: the camera of a photo in the file ({counts})"]


def _values(rows: Rows, name: str) -> NDArray[np.float64]:
    """All numbers of an element of one property [N]; none where it has several, or is missing."""
    table = rows.get(name)
    names = () if table is None else table.dtype.names or ()
    if table is None or len(names) != 1:
        return np.zeros(0)
    return np.asarray(table[names[0]], np.float64)
