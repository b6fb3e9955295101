"""A made-up room of opaque, flat splats: a floor, four walls and a pillar, each of one colour."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gsynopsis.jobs.import_splats import import_splats

HALF = 3.0
"""From the middle to each wall, world units."""
FLOOR = 1.2
"""Of the floor along y, which points down."""
HEIGHT = 2.4
PILLAR = (1.5, 0.4)
"""Where the pillar stands along z, and half of its width."""
STEP = 0.08
"""Between two splats."""
NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
NAMES += [f"scale_{axis}" for axis in range(3)] + [f"rot_{axis}" for axis in range(4)]


def plane(
    low: tuple[float, float, float], high: tuple[float, float, float], colour: int
) -> NDArray[np.float32]:
    """Rows of splats over a rectangle along two of the axes, [n, 14]."""
    axes = [
        np.arange(a, b + STEP / 2, STEP) if b > a else [a] for a, b in zip(low, high, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    rows = np.zeros((len(points), len(NAMES)), np.float32)
    rows[:, :3] = points
    rows[:, 3:6] = -1.2
    rows[:, 3 + colour] = 1.5
    rows[:, 6] = 5.0  # of a logistic
    flat = [np.log(0.004) if a == b else np.log(0.7 * STEP) for a, b in zip(low, high, strict=True)]
    rows[:, 7:10] = flat
    rows[:, 10] = 1.0
    return rows


def write_room(folder: Path) -> Path:
    """The room as a .gsyn file."""
    top, at, thin = FLOOR - HEIGHT, PILLAR[0], PILLAR[1]
    parts = [
        plane((-HALF, FLOOR, -HALF), (HALF, FLOOR, HALF), 0),
        plane((-HALF, top, HALF), (HALF, FLOOR, HALF), 1),
        plane((-HALF, top, -HALF), (HALF, FLOOR, -HALF), 1),
        plane((-HALF, top, -HALF), (-HALF, FLOOR, HALF), 2),
        plane((HALF, top, -HALF), (HALF, FLOOR, HALF), 2),
        plane((-thin, top, at), (thin, FLOOR, at), 0),
    ]
    rows = np.concatenate(parts)
    header = "".join(f"property float {name}\n" for name in NAMES)
    path = folder / "room.ply"
    text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{header}end_header\n"
    path.write_bytes(text.encode() + rows.astype("<f4").tobytes())
    with pytest.MonkeyPatch.context() as patch:
        # Nobody looks at which views of it are best, nor at figures and their pictures.
        patch.setattr("gsynopsis.cameras.found.TRIED", 40)
        patch.setattr("gsynopsis.cameras.found.AGAIN", ())
        patch.setattr("gsynopsis.jobs.import_splats.VIEWS_SIDE", 120)
        patch.setattr("gsynopsis.jobs.splat_views.SHEET_SIDE", 96)
        return import_splats(path, folder / "room.gsyn", up=(0.0, -1.0, 0.0), steps=0).path
