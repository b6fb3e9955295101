"""The result of every reader, and the checks that all readers make before they allocate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.formats.axes import DOWN, Up
from gsynopsis.records import HARMONICS, Float32, PlainGaussians

SPLATS_MAX = 20_000_000
"""More are refused: in memory each takes 248 bytes, and four times that while levels are made."""
SPLATS_FREE = 1 << 18
"""Splats that any file may claim; beyond these each needs `BYTES_LEAST` stored bytes."""
BYTES_LEAST = 4
"""Least stored bytes of a splat in a compressed file (ours: SOG and SPZ of real scenes have 8)."""
LOGIT_MAX = 16.0
"""Logit of opacities stored as 0 or 1, whose own logit is not finite."""
LOG_SCALE_LEAST = -30.0
"""Log-scale of flat splats, whose scale is 0."""
LOG_SCALE_MAX = 25.0
MEAN_MAX = 1e9
SH_MAX = 1e4
TURN_LEAST, TURN_MAX = 1e-12, 1e12
"""Length of quaternions."""
ALONE = 1e5
"""Median distances from the median position; splats farther away would coarsen all others."""
SHOWN_MAX = 80
"""Characters of a file that a message repeats."""


@dataclass(frozen=True)
class PhotoCamera:
    """The camera of the one photo that a network made splats of, as SHARP's files have it.

    Attributes:
        width: Of the photo, pixels.
        height: Of the photo, pixels.
        matrix: Intrinsics, pixels [3, 3].
        w2c: World to camera, x right, y down, z forward [4, 4].
    """

    width: int
    height: int
    matrix: NDArray[np.float64]
    w2c: NDArray[np.float64]


@dataclass(frozen=True)
class SplatFile:
    """Gaussians of a file.

    Attributes:
        levels: Coarsest first; one if the file has no levels. They need not be nested.
        antialiased: True if trained for the anti-aliased renderer (Mip-Splatting).
        up: World direction away from the ground, as far as file or format say, unit length.
        up_said: The file itself says it; else it is the format's custom, which files break.
        kind: Name of the format, for people.
        environment: Number of splats at the front of each level that are the same in all levels.
        notes: Assumptions and unused data, a line each.
        shift: What was taken from positions, in the file's axes.
        photo: Camera of the one photo that they were made of; None where no file says it.
    """

    levels: tuple[PlainGaussians, ...]
    antialiased: bool = False
    up: Up = DOWN
    kind: str = "PLY"
    environment: int = 0
    notes: tuple[str, ...] = ()
    up_said: bool = False
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    photo: PhotoCamera | None = None


def shown(value: object) -> str:
    """A value of a file, short enough for a message."""
    text = str(value)
    return text if len(text) <= SHOWN_MAX else f"{text[:SHOWN_MAX]}…"


def check_count(count: int, path: Path, field: str = "splats") -> None:
    """A number of splats that there can be.

    Raises:
        InputError: none, or more than `SPLATS_MAX`.
    """
    if count < 1:
        raise InputError(path, field, found="none", expected="at least one")
    if count > SPLATS_MAX:
        advice = "leave out what shows little, or cut the scene in parts"
        found = f"{count:,}" if count < 1 << 64 else "a number of more than 20 digits"
        raise InputError(
            path, field, found=found, expected=f"at most {SPLATS_MAX:,}", advice=advice
        )


def check_ratio(count: int, stored: int, path: Path) -> None:
    """Check that `stored` compressed bytes can hold `count` splats.

    Raises:
        InputError: there are more.
    """
    most = max(SPLATS_FREE, stored // BYTES_LEAST)
    if count > most:
        found = f"{count:,} in {stored:,} bytes"
        raise InputError(path, "splats", found=found, expected=f"at most {most:,}")


def check_room(found: int, needed: int, path: Path, field: str) -> None:
    """Check that there are as many bytes as the counts need.

    Raises:
        InputError: there are fewer.
    """
    if found < needed:
        raise InputError(path, field, found=f"{found:,} bytes", expected=f"{needed:,}")


def cleaned(file: SplatFile, path: Path, step: int = 1) -> SplatFile:
    """The file without splats that have values which are not finite or absurd, and lines about it.

    Opacities of 0 and 1 and scales of 0 get finite logarithms.

    Args:
        file: Its arrays are changed.
        path: What messages call it.
        step: Rows of the file from one splat to the next; more than 1 if it is a sample.

    Raises:
        InputError: more than half of a level's splats are so.
    """
    notes = list(file.notes)
    levels: list[PlainGaussians] = []
    environment = file.environment
    for number, gaussians in enumerate(file.levels):
        where = f"level {number}: " if len(file.levels) > 1 else ""
        good, line = _finite(gaussians, path, where, step)
        notes += [f"{where}{line}"] if line else []
        if not number and environment:
            environment = int(good[:environment].sum())
        levels.append(gaussians if good.all() else rows_of(gaussians, good.nonzero()[0]))
    return replace(file, levels=tuple(levels), environment=environment, notes=tuple(notes))


def _finite(g: PlainGaussians, path: Path, where: str, step: int) -> tuple[NDArray[np.bool_], str]:
    """Mask of splats with usable values, and a line about the others."""
    g.logits[:] = np.clip(g.logits, -LOGIT_MAX, LOGIT_MAX)
    flat = int((g.log_scales == -np.inf).any(axis=1).sum())
    np.maximum(g.log_scales, LOG_SCALE_LEAST, out=g.log_scales)
    colors, length = g.sh.reshape(len(g), -1), _most(g.quaternions)
    tests = {
        "position": (g.means, _most(g.means) <= MEAN_MAX),
        "scale": (g.log_scales, g.log_scales.max(axis=1) <= LOG_SCALE_MAX),
        "rotation": (g.quaternions, (length >= TURN_LEAST) & (length <= TURN_MAX)),
        "opacity": (g.logits[:, None], np.isfinite(g.logits)),
        "colour": (colors[:, :3], _most(colors) <= SH_MAX),
    }
    good = np.logical_and.reduce([found for _, found in tests.values()])
    tests["position (alone)"] = (g.means, _near(g.means, good))
    good &= tests["position (alone)"][1]
    told = [f"{flat:,} splats have a scale of 0: taken as flat"] if flat else []
    bad = len(g) - int(good.sum())
    if bad:
        row = int(np.argmin(good))
        name = next(name for name, (_, found) in tests.items() if not found[row])
        value = shown(np.array2string(tests[name][0][row], separator=" "))
        field = f"{where}splat {row * step}: {name}"
        if 2 * bad > len(g):
            expected = "finite numbers of a usual size, rotations not 0"
            advice = f"{bad:,} of {len(g):,} splats are so: the file is damaged"
            raise InputError(path, field, found=value, expected=expected, advice=advice)
        told.append(f"left out {bad:,} of {len(g):,} splats: not finite or absurd: {field} {value}")
    return good, "; ".join(told)


def _most(values: Float32) -> Float32:
    """The largest absolute value of each row, NaN where there is one; no copy of the values."""
    return np.maximum(values.max(axis=1), -values.min(axis=1))


def _near(means: Float32, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Positions that are not absurdly far from all others, among those that are good."""
    near = np.ones(len(means), np.bool_)
    if good.any():
        middle = np.median(means[good], axis=0)
        away = np.abs(means - middle).max(axis=1)
        usual = float(np.median(away[good]))
        near[good] = away[good] <= ALONE * usual if usual > 0 else True
    return near


def rows_of(gaussians: PlainGaussians, rows: NDArray[np.int64] | slice) -> PlainGaussians:
    """Some Gaussians of a set."""
    g = gaussians
    return PlainGaussians(
        g.means[rows], g.log_scales[rows], g.quaternions[rows], g.logits[rows], g.sh[rows]
    )


def joined(parts: Sequence[PlainGaussians]) -> PlainGaussians:
    """All of some Gaussians; harmonics that some lack are 0."""
    if len(parts) == 1:
        return parts[0]
    width = 1 + max(HARMONICS[part.degree] for part in parts) // 3
    sh = [np.pad(p.sh, ((0, 0), (0, width - p.sh.shape[1]), (0, 0))) for p in parts]
    return PlainGaussians(
        np.concatenate([p.means for p in parts]),
        np.concatenate([p.log_scales for p in parts]),
        np.concatenate([p.quaternions for p in parts]),
        np.concatenate([p.logits for p in parts]),
        np.concatenate(sh),
    )


def logits_of(opacities: NDArray[np.floating]) -> Float32:
    """Logits of opacities in [0, 1]; 0 and 1 become ∓`LOGIT_MAX`."""
    with np.errstate(divide="ignore"):
        logits = np.log(opacities) - np.log1p(-opacities)
    return np.clip(logits, -LOGIT_MAX, LOGIT_MAX).astype(np.float32)


def rest_names(names: set[str], path: Path) -> list[str]:
    """Names of the harmonics beyond the first in order: numbered on, from 0 or from 1.

    Raises:
        InputError: their number or their names are none of 3DGS.
    """
    rest = [name for name in names if name.startswith("f_rest_")]
    for start in (0, 1):
        wanted = [f"f_rest_{start + i}" for i in range(len(rest))]
        if len(rest) in HARMONICS and set(rest) == set(wanted):
            return wanted
    odd = sorted(set(rest) - {f"f_rest_{i}" for i in range(len(rest))})
    found = f"{len(rest)} properties f_rest" + (f", one of them {shown(odd[0])}" if odd else "")
    expected = f"{' or '.join(map(str, HARMONICS))}, numbered from 0"
    raise InputError(path, "header", found=found, expected=expected)
