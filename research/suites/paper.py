"""Tables in the paper's layout, levels × methods, then sizes and times; the paper's own figures.

Table I of the paper has quality, speed, size and delta of each level and method, means over a data
set's scenes; table II has sizes and training times. Ours are means over the scenes and seeds of a
suite.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from statistics import fmean

from research.suites.experiment import Row

FIGURES_FILE = "paper.csv"
"""The paper's tables I and II (arXiv 2604.11685): MB are of 10⁶ bytes, minutes of its GPU."""
MIB = 2**20
QUALITY = (("psnr", ".2f", "PSNR"), ("ssim", ".3f", "SSIM"), ("flip", ".3f", "FLIP"))
PUBLISHED = {
    "psnr": "PSNR",
    "ssim": "SSIM",
    "lpips": "LPIPS",
    "fps": "FPS",
    "size": "MB",
    "delta": "ΔMB",
    "train_min": "min",
}
DATASETS = {
    "mipnerf360": "Mip-NeRF 360",
    "bungeenerf": "BungeeNeRF",
    "deepblending": "Deep Blending",
    "tanksandtemples": "Tanks and Temples",
}


@dataclass(frozen=True)
class PaperTable:
    """A table: its heading, names of columns, lines of text."""

    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


def level_table(rows: Sequence[Row], kind: str) -> PaperTable:
    """Quality, speed, size and delta of each level and method, means over scenes and seeds.

    Args:
        rows: Of all scenes.
        kind: `full`: levels at the scale of the run, or `own`: each at its own size, as in the
            paper's table I.
    """
    names = [(f"{figure}_{kind}", form, title) for figure, form, title in QUALITY]
    if any(row.get(f"lpips_{kind}") is not None for row in rows):
        names.append((f"lpips_{kind}", ".3f", "LPIPS"))
    lines: list[tuple[str, ...]] = []
    for level in sorted({row["level"] for row in rows}):
        for method in dict.fromkeys(row["method"] for row in rows):
            same = [r for r in rows if (r["level"], r["method"]) == (level, method)]
            if not same:
                continue
            figures = [_mean(same, name, form) for name, form, _ in names]
            speed = _mean(same, "total_ms", ".1f")
            sizes = [_mean(same, name, ".3f", MIB) for name in ("bytes_compact", "delta_compact")]
            lines.append((f"L{level}", method, *figures, speed, *sizes))
    where = "at its own size" if kind == "own" else "at the scale of the run"
    columns = ("level", "method", *(title for _, _, title in names), "ms", "MiB", "ΔMiB")
    return PaperTable(f"Each level {where}", columns, tuple(lines))


def size_table(rows: Sequence[Row]) -> PaperTable:
    """Bytes in all accountings, rate and training time of each method, means over scenes, seeds."""
    lines: list[tuple[str, ...]] = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        finest = max(row["level"] for row in own)
        last = [row for row in own if row["level"] == finest]
        sizes = ("bytes_paper", "bytes_deflate", "bytes_raw", "bytes_compact")
        bits = [8 * row["bytes_compact"] / max(1, row["slots"]) for row in last]
        lines.append(
            (
                method,
                *(_mean(last, name, ".3f", MIB) for name in sizes),
                f"{fmean(bits):.1f}",
                _mean(last, "seconds", ".1f", 60),
            )
        )
    columns = ("method", "float32 rows, MiB", "DEFLATE", "raw file", "our coder")
    return PaperTable("Sizes and times", (*columns, "bits a Gaussian", "minutes"), tuple(lines))


def published_tables() -> list[PaperTable]:
    """The paper's own figures, of each data set; levels, then methods."""
    text = resources.files("research.suites").joinpath(FIGURES_FILE).read_text("utf-8")
    rows = list(csv.DictReader(io.StringIO(text)))
    tables: list[PaperTable] = []
    for known, title in DATASETS.items():
        own = sorted((r for r in rows if r["dataset"] == known), key=lambda row: row["level"])
        lines = tuple(
            (r["level"], r["method"], *(r[name] or "–" for name in PUBLISHED)) for r in own
        )
        tables.append(PaperTable(title, ("level", "method", *PUBLISHED.values()), lines))
    return tables


def _mean(rows: Sequence[Row], name: str, form: str, unit: float = 1.0) -> str:
    """Mean of a column, `n/a` where a row lacks it."""
    values = [row.get(name) for row in rows]
    known = [value / unit for value in values if value is not None]
    return f"{fmean(known):{form}}" if values and len(known) == len(values) else "n/a"
