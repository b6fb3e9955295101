"""What benchmarks that write into docs share: marked parts of a page, a CSV's rows, the commit."""

import csv
from collections.abc import Collection
from pathlib import Path
from typing import Any

from gsynopsis.evaluate.machine import this_build

END = "<!-- end -->"


def put(page: Path, script: str, text: str) -> None:
    """Replace what stands between the marks of a script, `<!-- begin: benchmarks/… -->` and `END`.

    Args:
        page: A Markdown page that holds the marks.
        script: The script's name, as `size.py`.
        text: Markdown; blank lines around it are ours.
    """
    begin = f"<!-- begin: benchmarks/{script} -->"
    old = page.read_text("utf-8")
    before, rest = old.split(begin, 1)
    after = rest.split(END, 1)[1]
    page.write_text(f"{before}{begin}\n\n{text.rstrip()}\n\n{END}{after}", "utf-8")


def stored_rows(path: Path, text: Collection[str]) -> list[dict[str, Any]]:
    """The rows of a CSV as they were written: numbers, but for the columns of text."""
    with path.open(newline="", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    return [{n: v if n in text else _number(v) for n, v in row.items()} for row in rows]


def _number(text: str) -> int | float | str:
    if not text:
        return text  # a column that was not measured yet
    try:
        return int(text)
    except ValueError:
        return float(text)


def short_commit() -> str:
    """The commit that measured, twelve digits; `unknown` outside of a checkout."""
    return (this_build().commit or "unknown")[:12]
