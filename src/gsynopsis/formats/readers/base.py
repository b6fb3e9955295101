"""What every reader gives, and the checks that all of them make before they allocate anything."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.records import PlainGaussians

SPLATS_MAX = 20_000_000
"""More are refused: in memory each takes 248 bytes, and four times that while levels are made."""
LOGIT_MAX = 16.0
"""Of opacities that a file has as 0 or 1: their logit is not finite."""
DOWN = (0.0, -1.0, 0.0)
"""Up in files that keep COLMAP's axes, as those of 3DGS do."""
UP = (0.0, 1.0, 0.0)

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class SplatFile:
    """Gaussians of a file.

    Attributes:
        levels: Coarsest first; one where the file knows no levels. They need not be nested.
        antialiased: They were trained for the anti-aliased renderer (Mip-Splatting).
        up: World direction away from the ground, as far as the format says.
        kind: Name of the format, for people.
    """

    levels: tuple[PlainGaussians, ...]
    antialiased: bool = False
    up: tuple[float, float, float] = DOWN
    kind: str = "PLY"


def check_count(count: int, path: Path, field: str = "splats") -> None:
    """A number of splats that there can be.

    Raises:
        InputError: none, or more than `SPLATS_MAX`.
    """
    if count < 1:
        raise InputError(path, field, found="none", expected="at least one")
    if count > SPLATS_MAX:
        advice = "leave out what shows little, or cut the scene in parts"
        raise InputError(
            path, field, found=f"{count:,}", expected=f"at most {SPLATS_MAX:,}", advice=advice
        )


def check_room(found: int, needed: int, path: Path, field: str) -> None:
    """There are as many bytes as counts say.

    Raises:
        InputError: there are fewer.
    """
    if found < needed:
        raise InputError(path, field, found=f"{found:,} bytes", expected=f"{needed:,}")


def checked(gaussians: PlainGaussians, path: Path) -> PlainGaussians:
    """Gaussians whose values are all finite, with opacities of 0 and 1 made so.

    Raises:
        InputError: a value is not finite, or a quaternion is 0.
    """
    gaussians.logits[:] = np.clip(gaussians.logits, -LOGIT_MAX, LOGIT_MAX)
    arrays = {
        "position": gaussians.means,
        "scale": gaussians.log_scales,
        "rotation": gaussians.quaternions,
        "opacity": gaussians.logits[:, None],
        "colour": gaussians.sh.reshape(len(gaussians), -1),
    }
    for name, array in arrays.items():
        good = np.isfinite(array).all(axis=1)
        if name == "rotation":
            good &= array.any(axis=1)
        if not good.all():
            row = int(np.argmin(good))
            field = f"splat {row}: {name}"
            bad = len(good) - int(good.sum())
            advice = f"{bad:,} splats are so; leave them out first"
            expected = "finite numbers, rotations not 0"
            raise InputError(path, field, found=array[row], expected=expected, advice=advice)
    return gaussians


def logits_of(opacities: NDArray[np.floating]) -> Float32:
    """Logits of opacities in [0, 1]; 0 and 1 become ∓`LOGIT_MAX`."""
    with np.errstate(divide="ignore"):
        logits = np.log(opacities) - np.log1p(-opacities)
    return np.clip(logits, -LOGIT_MAX, LOGIT_MAX).astype(np.float32)
