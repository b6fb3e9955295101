"""A report to files: metrics.json, metrics.csv, views.csv, contact.png, report.html."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.errors import MissingExtraError
from gsynopsis.evaluation.contact_sheet import contact_sheet
from gsynopsis.evaluation.report import Json, Report, level_row, report_json, view_row
from gsynopsis.files import publish


@dataclass(frozen=True)
class Written:
    """Files that were written, and a sentence for each that was not."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def write_report(report: Report, folder: Path) -> Written:
    """Write all forms of a report into a folder, each file whole or not at all.

    Without the extra `plots` there is no HTML page; the note says so.
    """
    files = [
        publish(folder / "metrics.json", report_json(report)),
        publish(folder / "metrics.csv", csv_text([level_row(report, s) for s in report.levels])),
        publish(folder / "views.csv", csv_text([view_row(s) for s in report.views])),
    ]
    if report.pictures:
        files.append(publish(folder / "contact.png", _png(report)))
    try:
        from gsynopsis.evaluation.report_html import report_page
    except MissingExtraError as error:
        return Written(tuple(files), (f"no report.html: {error}",))
    files.append(publish(folder / "report.html", report_page(report)))
    return Written(tuple(files), ())


def names_of(folder: Path) -> list[Path]:
    """The files of a report that are there."""
    names = ("metrics.json", "metrics.csv", "views.csv", "contact.png", "report.html")
    return [folder / name for name in names if (folder / name).is_file()]


def csv_text(rows: Sequence[Mapping[str, Json]]) -> str:
    """Rows of the same columns as CSV; None is an empty cell."""
    page = io.StringIO()
    writer = csv.DictWriter(page, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return page.getvalue()


def _png(report: Report) -> bytes:
    buffer = io.BytesIO()
    contact_sheet(report).save(buffer, "PNG")
    return buffer.getvalue()
