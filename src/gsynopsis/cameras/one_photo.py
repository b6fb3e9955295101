"""Cameras of splats that a network made of one photo, as SHARP does (ours).

There is nothing behind what the photo shows and little beside it: cameras stand about the photo's
own, as far as its nearest parts allow. Files of SHARP have that camera. Elsewhere it is found, as
such splats, a few for each pixel, fill one picture evenly as seen from the origin of the world.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.cameras.viewpoints import Viewpoints, with_up
from gsynopsis.formats.axes import Up
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.scene.camera import Camera, look_from
from gsynopsis.scene.views import moved

REACH = 0.1
"""Farthest that cameras stand from the photo's, times the depth of its nearest parts."""
NEAREST, MIDDLE = 0.05, 0.5
"""Shares of splats that are nearer than its nearest parts, and than what cameras look at."""
SEEN = 0.5
"""Least share of splats that the camera of a file has in its picture: else they were moved."""
GOLDEN = np.pi * (3 - np.sqrt(5))
AHEAD = 0.999
"""Least share of splats before the camera."""
CELLS, FEWEST, MOST, EACH = 16, 0.5, 2.0, 16
"""Cells of the picture along each side, how many splats each has at least and at most, times their
mean, and that mean at least."""
DEEP = 1.2
"""Least depth of the farthest parts over that of the nearest: ground from the air is flat."""
EDGE = 0.002
"""Share of splats beyond each edge of the picture."""
WIDEST, NARROWEST = 1.5, 0.05
"""Largest distance of the picture's edges from its middle, over the depth, and its least width."""
SAMPLE = 1 << 18
"""Splats that are looked at, evenly chosen: of millions they tell as much."""
SIDE = 1024
"""Longer side of the picture of a camera that was found, pixels."""
Float64 = NDArray[np.float64]


def of_one_photo(
    splats: SplatFile, up: Up | None, count: int, width: int
) -> tuple[Viewpoints | None, list[str]]:
    """Cameras about that of the one photo that splats were made of; None: they were not.

    And a line where the file has such a camera that sees little of them.

    Args:
        splats: The scene; its finest level counts.
        up: Away from the ground; None: as the file says, else as the photo was held.
        count: Of cameras, the photo's own first.
        width: Of the longer side of their pictures, pixels.
    """
    finest = splats.levels[-1].means
    means = finest[:: -(-len(finest) // SAMPLE)].astype(np.float64)
    photo, evidence, notes = _given(splats), "the file has it", list[str]()
    if photo is not None and photo.framed(means).which.mean() < SEEN:
        photo, notes = None, ["not used: the photo's camera in the file, which sees little of it"]
    if photo is None:
        photo, evidence = _found(means), "they fill one picture from the origin"
    if photo is None:
        return None, notes
    photo = photo.within(width)
    held = "as asked for" if up is not None else "as the photo was held"
    if up is None and splats.up_said:
        up, held = splats.up, "as the file says"
    if up is None:
        x, y, z = (-photo.w2c[1, :3] + 0.0).tolist()
        up = (x, y, z)
    line = (
        f"cameras: {count} about that of the one photo that these splats are made of ({evidence})"
    )
    cameras = tuple(_about(photo, means, count))
    return Viewpoints(cameras, up, False, (with_up(line, up, held),)), notes


def _given(splats: SplatFile) -> Camera | None:
    own = splats.photo
    if own is None:
        return None
    (fx, _, cx), (_, fy, cy), _ = own.matrix.tolist()
    camera = Camera(own.width, own.height, fx, fy, cx, cy, own.w2c)
    return moved(camera, -np.array(splats.shift))


def _found(means: Float64) -> Camera | None:
    """The camera at the origin whose picture splats fill evenly, if there is one."""
    # Looking along z with y down, as COLMAP's; or with y up, as in SPZ files.
    for sign in (1.0, -1.0):
        turn = np.diag([1.0, sign, sign])
        x, y, z = turn @ means.T
        ahead = z > 0
        if ahead.mean() < AHEAD:
            continue
        slopes = np.stack([x[ahead], y[ahead]]) / z[ahead]
        low, high = np.quantile(slopes, [EDGE, 1 - EDGE], axis=1)
        if np.abs([low, high]).max() > WIDEST or (high - low).min() < NARROWEST:
            continue
        counts = np.histogram2d(slopes[0], slopes[1], CELLS, np.stack([low, high], axis=1))[0]
        mean = counts.mean()
        evenly = counts.min() >= FEWEST * mean and counts.max() <= MOST * mean
        nearest, farthest = np.quantile(z, [NEAREST, 1 - NEAREST])
        if mean >= EACH and evenly and farthest >= DEEP * nearest:
            focal = SIDE / float((high - low).max())
            width, height = (max(1, round(focal * side)) for side in (high - low).tolist())
            cx, cy = (-focal * low).tolist()
            w2c = np.eye(4)
            w2c[:3, :3] = turn
            return Camera(width, height, focal, focal, cx, cy, w2c)
    return None


def _about(photo: Camera, means: Float64, count: int) -> list[Camera]:
    """The photo's camera, and others on a disc around it and a little before and behind that.

    All look at what stands in the middle of its picture.
    """
    depths = means @ photo.w2c[2, :3] + photo.w2c[2, 3]
    nearest, middle = np.quantile(np.maximum(depths, 0.0), [NEAREST, MIDDLE])
    number = np.arange(count)
    away, turn = REACH * nearest * np.sqrt(number / count), GOLDEN * number
    along = REACH * nearest * (2 * (number / ((1 + np.sqrt(5)) / 2) % 1) - 1)
    along[0] = 0.0
    steps = np.stack([away * np.cos(turn), away * np.sin(turn), along], axis=1)
    eyes = photo.position + steps @ photo.w2c[:3, :3]
    w2c = look_from(eyes, photo.position + middle * photo.forward, -photo.w2c[1, :3])
    return [replace(photo, w2c=each) for each in w2c]
