"""The contact sheet of an import: what each chosen camera sees, for a person to judge."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

COLUMNS = 6
CELL = (240, 180)
"""Largest picture, pixels."""
GAP, LINE = 6, 18
"""Between pictures, and of a line of text, pixels."""
PAPER, INK = (250, 250, 248), (32, 34, 38)


def sheet_path(out: Path) -> Path:
    """Path of a file's sheet: NAME.cameras.png beside it."""
    return out.with_name(f"{out.stem}.cameras.png")


def contact_sheet(pictures: Sequence[NDArray[np.uint8]], title: str) -> Image.Image:
    """Pictures [H, W, 3] with their numbers, under a line of text.

    Args:
        pictures: At least one; larger ones are made smaller.
        title: What the sheet shows; of Latin letters.
    """
    cells = [_fitted(picture) for picture in pictures]
    width, height = (max(cell.size[axis] for cell in cells) for axis in (0, 1))
    rows = -(-len(cells) // COLUMNS)
    columns = min(COLUMNS, len(cells))
    size = (
        max(480, columns * (width + GAP) + GAP),
        2 * LINE + rows * (height + LINE + GAP),
    )
    sheet = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    draw.text((GAP, LINE // 2), title, INK, font)
    for number, cell in enumerate(cells):
        row, column = divmod(number, COLUMNS)
        left, top = GAP + column * (width + GAP), 2 * LINE + row * (height + LINE + GAP)
        sheet.paste(cell, (left, top))
        draw.text((left, top + cell.height + 2), str(number + 1), INK, font)
    return sheet


def _fitted(picture: NDArray[np.uint8]) -> Image.Image:
    image = Image.fromarray(picture)
    image.thumbnail(CELL, Image.Resampling.BOX)
    return image
