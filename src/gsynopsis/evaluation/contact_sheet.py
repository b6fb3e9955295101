"""The contact sheet: truth, every level, and every level's error, for a few held-out views."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gsynopsis.evaluation.formatting import scale_text, size
from gsynopsis.evaluation.metrics import Image8, psnr
from gsynopsis.evaluation.report import Pictures, Report, views_text

Font = ImageFont.ImageFont | ImageFont.FreeTypeFont
ERROR_GAIN = 4
"""Factor on the error before it is coloured."""
RAMP = np.array(
    [[0, 0, 4], [51, 16, 104], [136, 34, 106], [203, 65, 73], [246, 139, 30], [252, 255, 190]],
    dtype=np.float64,
)
"""Colours of errors of 0, 0.2, … 1 after amplification: dark to light, readable in grey."""
PAPER = (250, 250, 248)
INK = (32, 34, 38)
FAINT = (112, 116, 124)


@dataclass(frozen=True)
class Grid:
    """Measures of the sheet, pixels.

    Attributes:
        cell: Largest width and height of one image.
        gap: Between images.
        margin: Around the sheet.
        line: Height of a line of text.
    """

    cell: tuple[int, int] = (360, 340)
    gap: int = 12
    margin: int = 28
    line: int = 22


def error_image(image: Image8, truth: Image8) -> Image8:
    """The absolute error, largest of the three channels, amplified and coloured by RAMP."""
    difference = np.abs(image.astype(np.int16) - truth.astype(np.int16)).max(axis=2)
    position = np.clip(difference * (ERROR_GAIN / 255.0), 0.0, 1.0)
    return ramp_colors(position)


def ramp_colors(position: NDArray[np.float64]) -> Image8:
    """Values in [0, 1] of any shape [...] to colours of the ramp, uint8 [..., 3]."""
    stops = np.linspace(0.0, 1.0, len(RAMP))
    channels = [np.interp(position, stops, RAMP[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def head_height(grid: Grid) -> int:
    """Top of the first row of images, pixels."""
    return grid.margin + 4 * grid.line


def contact_sheet(report: Report, grid: Grid | None = None) -> Image.Image:
    """One image with a render of each level and its error."""
    grid = grid or Grid()
    cell = _fitted(report.pictures, grid.cell)
    block = 2 * (cell[1] + grid.line) + 2 * grid.gap
    columns = 1 + len(report.levels)
    width = 2 * grid.margin + columns * cell[0] + (columns - 1) * grid.gap
    head = head_height(grid)
    height = head + len(report.pictures) * block + grid.margin - grid.gap
    sheet = Image.new("RGB", (max(width, 640), height), PAPER)
    _title(sheet, report, grid)
    _columns(sheet, report, (head - grid.line, cell[0]), grid)
    for row, pictures in enumerate(report.pictures):
        _block(sheet, report, pictures, (head + row * block, *cell), grid)
    return sheet


def _title(sheet: Image.Image, report: Report, grid: Grid) -> None:
    draw = ImageDraw.Draw(sheet)
    draw.text((grid.margin, grid.margin - 6), report.scene, INK, _font(24))
    facts = [f"scale {scale_text(report.scale)}", f"{report.width} x {report.height}"]
    facts += [f"preset {report.provenance.preset}"] if report.provenance.preset else []
    facts += [views_text(report), "every level at that size"]
    draw.text((grid.margin, grid.margin + 26), "  ·  ".join(facts), FAINT, _font(14))


def _columns(sheet: Image.Image, report: Report, place: tuple[int, int], grid: Grid) -> None:
    """Draw the head of each column: level and bytes up to it; place is (y, column width)."""
    top, width = place
    draw, strong, faint = ImageDraw.Draw(sheet), _font(15), _font(13)
    draw.text((grid.margin, top), "ground truth", INK, strong)
    for score in report.levels:
        left = grid.margin + (1 + score.level) * (width + grid.gap)
        draw.text((left, top), f"L{score.level}", INK, strong)
        bytes_ = size(score.sizes.bytes_compact)
        draw.text((left + width, top + 2), bytes_, FAINT, faint, anchor="ra")


def _block(
    sheet: Image.Image,
    report: Report,
    pictures: Pictures,
    place: tuple[int, int, int],
    grid: Grid,
) -> None:
    """One view: the ground truth and the levels above, their errors below; place is (y, w, h)."""
    top, width, height = place
    below = top + height + grid.line + grid.gap // 2
    _cell(sheet, pictures.truth, (grid.margin, top, width, height), pictures.view)
    _legend(sheet, (grid.margin, below, width, height))
    for score, image in zip(report.levels, pictures.levels, strict=True):
        left = grid.margin + (1 + score.level) * (width + grid.gap)
        quality = f"{psnr(image, pictures.truth):.2f} dB"
        _cell(sheet, image, (left, top, width, height), quality)
        error = error_image(image, pictures.truth)
        _cell(sheet, error, (left, below, width, height), "")


def _cell(
    sheet: Image.Image,
    image: Image8,
    box: tuple[int, int, int, int],
    label: str,
) -> None:
    """An image in the box (x, y, w, h), with a word under it."""
    left, top, width, height = box
    sheet.paste(_resized(image, (width, height)), (left, top))
    draw = ImageDraw.Draw(sheet)
    font = _font(13)
    draw.text((left, top + height + 4), _shortened(draw, label, font, width), FAINT, font)


def _legend(sheet: Image.Image, box: tuple[int, int, int, int]) -> None:
    """The scale of the error colours, standing where the photo's own error would be."""
    left, top, width, height = box
    bar = min(width, 220)
    middle = top + height // 2
    ramp = ramp_colors(np.tile(np.linspace(0.0, 1.0, bar), (12, 1)))
    sheet.paste(Image.fromarray(ramp), (left, middle))
    draw, font = ImageDraw.Draw(sheet), _font(13)
    draw.text((left, middle - 20), f"error, amplified {ERROR_GAIN} times", INK, font)
    draw.text((left, middle + 16), "0", FAINT, font)
    draw.text(
        (left + bar, middle + 16), f"{255 // ERROR_GAIN} of 255 or more", FAINT, font, anchor="ra"
    )


def _fitted(pictures: Sequence[Pictures], limit: tuple[int, int]) -> tuple[int, int]:
    """The cell: the first image at a size within the limit, small ones enlarged whole times."""
    if not pictures:
        return limit
    height, width = pictures[0].truth.shape[:2]
    ratio = min(limit[0] / width, limit[1] / height)
    ratio = float(int(ratio)) if ratio >= 1.0 else ratio
    return max(1, round(width * ratio)), max(1, round(height * ratio))


def _resized(image: Image8, cell: tuple[int, int]) -> Image.Image:
    """The image inside a cell: pixels stay sharp when enlarged, averaged when reduced."""
    picture = Image.fromarray(image)
    if picture.size == cell:
        return picture
    grows = picture.width <= cell[0]
    return picture.resize(cell, Image.Resampling.NEAREST if grows else Image.Resampling.BOX)


def _shortened(draw: ImageDraw.ImageDraw, text: str, font: Font, width: int) -> str:
    while len(text) > 4 and draw.textlength(text, font) > width:
        text = text[:-2].rstrip("…") + "…"
    return text


def _font(pixels: int) -> Font:
    """Pillow's own font: it has Latin letters, but not × or ≥."""
    return ImageFont.load_default(pixels)
