"""Block utility as a note of the manifest: one byte a block.

A client that knows it can ask first for the blocks of the highest utility per byte.
"""

import base64
import binascii
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BLOCKS_MAX = 3072
"""A file of more blocks carries no utilities: the note would pass 4 KiB, all before the base."""
STEPS_PER_DB = 4.0
"""Numbers to a decibel; 1 to 255 reach from -63.5 dB to 0 dB."""

Float64 = NDArray[np.float64]


def utility_text(utilities: Sequence[Float64]) -> str:
    """Block utilities as the text of the note; empty if the file has too many blocks for it.

    Args:
        utilities: For each level from 1 on, of each block in the order of the file. A block's
            utility is the mean squared error of colour, on [0, 1], that it removes from the part of
            the image that shows it. Float64 [blocks], each 0 to 1.
    """
    joined = np.concatenate(utilities) if utilities else np.zeros(0)
    if not 0 < len(joined) <= BLOCKS_MAX:
        return ""
    decibels = 10 * np.log10(np.clip(joined, 1e-30, 1.0))
    numbers = np.clip(np.rint(255 + STEPS_PER_DB * decibels), 0, 255).astype(np.uint8)
    return base64.b64encode(numbers.tobytes()).decode("ascii")


def parse_utility(text: str, blocks: Sequence[int]) -> list[Float64] | None:
    """Utility of each block from the text of the note; None if it does not fit the file.

    Args:
        text: The note.
        blocks: How many blocks each level from 1 on has.
    """
    try:
        numbers = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except (binascii.Error, ValueError):
        return None
    if len(numbers) != sum(blocks) or not len(numbers):
        return None
    values = 10 ** ((numbers.astype(np.float64) - 255) / STEPS_PER_DB / 10)
    values[numbers == 0] = 0.0
    return np.split(values, np.cumsum(blocks)[:-1])
