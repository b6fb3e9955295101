"""The report as one HTML file: figures, images and settings inside it, no links out."""

import base64
import io
from importlib import resources

from PIL import Image

from gsynopsis.errors import MissingExtraError
from gsynopsis.evaluation.contact_sheet import ERROR_GAIN, error_image
from gsynopsis.evaluation.formatting import mib, pixels, scale_text, size
from gsynopsis.evaluation.metrics import Image8
from gsynopsis.evaluation.report import (
    PROTOCOL,
    SWITCH_COLUMNS,
    Pictures,
    Report,
    columns_of,
    level_cells,
    photos_text,
    settings_of,
    switch_cells,
    views_text,
)
from gsynopsis.evaluation.report_curves import quality_curves

try:
    import jinja2
except ImportError as error:
    raise MissingExtraError("jinja2", "plots") from error

TEMPLATE = "report.html.j2"
JPEG_QUALITY = 90
"""JPEG quality of the images in the page. They are for looking; the contact sheet is lossless."""


def report_page(report: Report) -> str:
    """The HTML text, with every resource inlined."""
    source = resources.files("gsynopsis.evaluation").joinpath(TEMPLATE).read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(source).render(
        report=report,
        views=views_text(report),
        scale=scale_text(report.scale),
        summary=_summary(report),
        # A header may break, but not within a size.
        columns=[name.replace(" × ", "\u00a0×\u00a0") for name in columns_of(report)],
        photos=photos_text(report),
        rows=[level_cells(score) for score in report.levels],
        switch_columns=SWITCH_COLUMNS,
        switches=[switch_cells(switch) for switch in report.switches],
        full=quality_curves(report.levels, "full"),
        own=quality_curves(report.levels, "own"),
        bars=_bars(report),
        shows=[_show(pictures) for pictures in report.pictures],
        gain=ERROR_GAIN,
        settings=settings_of(report),
        protocol=PROTOCOL,
    )


def _summary(report: Report) -> list[tuple[str, str, str]]:
    """The four figures on top of the page: value, unit, name."""
    first, last = report.levels[0], report.levels[-1]
    at = f"pictures of {pixels(report.width, report.height)}"
    at += ", inside the masks" if report.masked else ""
    return [
        (f"{last.quality.psnr:.2f}", "dB", f"PSNR of L{last.level}, {at}{_at_photos(report)}"),
        (f"{first.quality.psnr:.2f}", "dB", f"PSNR of L{first.level}, {at}"),
        (mib(last.sizes.bytes_compact), "MiB", f"whole file, {last.anchors:,} anchors"),
        (mib(first.sizes.bytes_compact), "MiB", f"until L{first.level} can be shown"),
    ]


def _at_photos(report: Report) -> str:
    """The finest level at the photos' own size, where that is another one."""
    value, photo = report.levels[-1].quality.psnr_photo, report.photo
    if value is None or photo is None or report.scale == 1:
        return ""
    return f"; {value:.2f} dB at {pixels(photo.width, photo.height)}, the photos' own"


def _bars(report: Report) -> list[tuple[str, str, float]]:
    """Each level's delta: name, size as text, percent of the whole file."""
    whole = max(1, sum(score.sizes.delta_compact for score in report.levels))
    return [
        (
            f"L{score.level}",
            size(score.sizes.delta_compact),
            100 * score.sizes.delta_compact / whole,
        )
        for score in report.levels
    ]


def _show(pictures: Pictures) -> dict[str, object]:
    """One view as named slides, each an image as a data URI."""
    slides = [("ground truth", data_uri(pictures.truth))]
    slides += [(f"L{i}", data_uri(image)) for i, image in enumerate(pictures.levels)]
    errors = [error_image(image, pictures.truth) for image in pictures.levels]
    slides += [(f"error L{i}", data_uri(image)) for i, image in enumerate(errors)]
    return {"view": pictures.view, "slides": slides}


def data_uri(image: Image8) -> str:
    """An image as a JPEG inside a URI."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
