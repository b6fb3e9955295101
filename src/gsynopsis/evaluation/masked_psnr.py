"""PSNR of a part of an image: inside a mask, and after the exposure of the photo was taken out."""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.evaluation.metrics import PSNR_CAP, Image8

Inside = NDArray[np.bool_]
"""Pixels that count, [H, W]."""


def psnr_inside(image: Image8, truth: Image8, inside: Inside) -> float | None:
    """Peak signal-to-noise ratio over the pixels inside, dB, at most PSNR_CAP; None without any."""
    if not inside.any():
        return None
    error = float(np.square(image[inside].astype(np.float64) - truth[inside]).mean()) / 255.0**2
    return PSNR_CAP if error == 0 else min(PSNR_CAP, -10.0 * float(np.log10(error)))


def psnr_exposed(image: Image8, truth: Image8, inside: Inside | None = None) -> float | None:
    """PSNR of the right half after an affine colour that the left half solves for, dB.

    Args:
        image: A rendering.
        truth: Its photo.
        inside: Pixels that count, [H, W]; None: all.
    """
    counts = np.ones(image.shape[:2], np.bool_) if inside is None else inside
    half = image.shape[1] // 2
    left = counts[:, :half]
    if left.sum() < 4:
        return None
    known, wanted = image[:, :half][left].astype(np.float64), truth[:, :half][left]
    rows = np.hstack([known, np.ones((len(known), 1))])
    solution = np.linalg.lstsq(rows, wanted.astype(np.float64), rcond=None)[0]  # [4, 3]
    right = image[:, half:].astype(np.float64) @ solution[:3] + solution[3]
    exposed = np.rint(right.clip(0, 255)).astype(np.uint8)
    return psnr_inside(exposed, truth[:, half:], counts[:, half:])
