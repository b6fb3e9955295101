"""Results of a suite: CSV, and one page with curves and BD-rates."""

# Matplotlib leaves **kwargs untyped:
# pyright: reportUnknownMemberType=false

import io
from collections.abc import Sequence
from importlib import resources
from statistics import fmean, stdev

from gsynopsis.errors import MissingExtraError
from gsynopsis.evaluation.report_files import csv_text
from research.suites.bdrate import BdRate, bd_rate, is_wide, pooled_spread, shared_range
from research.suites.experiment import COLUMNS, Row
from research.suites.paper import level_table, published_tables, size_table

try:
    import jinja2
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from gsynopsis.evaluation.report_curves import STYLE, inline_svg
except ImportError as error:
    raise MissingExtraError("matplotlib and jinja2", "plots") from error

TEMPLATE = "page.html.j2"
KINDS = {"full": "PSNR at the scale of the run, dB", "own": "PSNR at each level's own size, dB"}
Curve = list[tuple[float, float]]
"""Bytes and PSNR of each level, coarsest first."""


def suite_csv(rows: Sequence[Row]) -> str:
    """One row a cell and level."""
    return csv_text([{name: row.get(name) for name in COLUMNS} for row in rows])


def suite_page(title: str, rows: Sequence[Row], anchor: str) -> str:
    """The page as HTML, everything inside it."""
    source = resources.files("research.suites").joinpath(TEMPLATE).read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    return environment.from_string(source).render(
        title=title,
        anchor=anchor,
        parts=[_part([r for r in rows if r["scene"] == s], anchor) for s in scenes],
        tables=[level_table(rows, "own"), level_table(rows, "full"), size_table(rows)],
        published=published_tables(),
        made=made_on(rows),
    )


def _part(rows: Sequence[Row], anchor: str) -> dict[str, object]:
    """One scene of the page."""
    first, methods = rows[0], list(dict.fromkeys(row["method"] for row in rows))
    about = (
        f"{first['width']} × {first['height']} pixels, {first['test_photos']} test photos, "
        f"split {first['split']}, scale {first['scale']:g}"
    )
    return {
        "scene": first["scene"],
        "about": about,
        "curves": [rate_curves(rows, kind) for kind in KINDS],
        "table": [_line(rows, method, anchor) for method in methods],
        "levels": sorted({row["level"] for row in rows}),
    }


def _line(rows: Sequence[Row], method: str, anchor: str) -> dict[str, object]:
    """One method of a scene: BD-rates, then size and quality of each level."""
    own = [row for row in rows if row["method"] == method]
    levels = sorted({row["level"] for row in own})
    cells: list[str] = []
    for level in levels:
        same = [row for row in own if row["level"] == level]
        mib = fmean(row["bytes_compact"] for row in same) / 2**20
        cells.append(f"{mib:.3f} MiB, {spread([row['psnr_full'] for row in same])} dB")
    return {
        "method": method,
        "seeds": len({row["seed"] for row in own}),
        "rates": [rate_text(rates_of(rows, method, anchor, kind)) for kind in KINDS],
        "levels": cells,
        "seconds": f"{fmean(row['seconds'] for row in own):.0f}",
        "peak": f"{max(row['peak_mib'] for row in own):,.0f}",
    }


def curve_of(rows: Sequence[Row], method: str, seed: int, kind: str) -> Curve:
    """Bytes and PSNR of the levels of one cell."""
    own = [row for row in rows if (row["method"], row["seed"]) == (method, seed)]
    own.sort(key=lambda row: row["level"])
    return [(row["bytes_compact"], row[f"psnr_{kind}"]) for row in own]


def rates_of(rows: Sequence[Row], method: str, anchor: str, kind: str) -> list[BdRate]:
    """BD-rates of a method against the anchor, of each seed that both have.

    None of them where their curves share too little to say anything (`is_wide`).

    Args:
        rows: Of one scene.
        method: Whose.
        anchor: Against what.
        kind: `full` or `own`.
    """
    seeds = [{r["seed"] for r in rows if r["method"] == name} for name in (method, anchor)]
    found = [
        bd_rate(curve_of(rows, anchor, seed, kind), curve_of(rows, method, seed, kind))
        for seed in sorted(set.intersection(*seeds))
    ]
    rates = [rate for rate in found if rate is not None]
    spread_ = max(spread_of(rows, name, kind) for name in (method, anchor))
    return rates if is_wide(rates, spread_) else []


def spread_of(rows: Sequence[Row], method: str, kind: str) -> float:
    """Standard deviation of a method's PSNR over seeds, pooled over its levels, dB."""
    own = [row for row in rows if row["method"] == method]
    levels = sorted({row["level"] for row in own})
    return pooled_spread([[r[f"psnr_{kind}"] for r in own if r["level"] == k] for k in levels])


def rate_text(rates: Sequence[BdRate]) -> str:
    """Mean and spread over seeds, with the range of PSNR that all of them have."""
    if not rates:
        return "n/a"
    low, high = shared_range(rates)
    return f"{spread([rate.percent for rate in rates], '+.1f')} % ({low:.1f} to {high:.1f} dB)"


def spread(values: Sequence[float], form: str = ".2f") -> str:
    """Mean, and ± the standard deviation where there is more than one."""
    mean = f"{fmean(values):{form}}"
    return f"{mean} ± {stdev(values):{form.lstrip('+')}}" if len(values) > 1 else mean


def rate_curves(rows: Sequence[Row], kind: str) -> str:
    """Quality over bytes of each method, mean of its seeds, as an SVG element."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": kind}):
        figure = Figure(figsize=(8.6, 3.6), layout="constrained")
        axes = figure.add_subplot()
        for method in dict.fromkeys(row["method"] for row in rows):
            seeds = sorted({row["seed"] for row in rows if row["method"] == method})
            curves = [curve_of(rows, method, seed, kind) for seed in seeds]
            points = list(zip(*curves, strict=False))
            sizes = [fmean(size for size, _ in level) / 2**20 for level in points]
            axes.plot(sizes, [fmean(q for _, q in level) for level in points], "o-", label=method)
        axes.set(xscale="log", xlabel="MiB up to the level's end", title=KINDS[kind])
        axes.legend(loc="lower right", fontsize=9)
        page = io.StringIO()
        figure.savefig(page, format="svg", transparent=True, metadata={"Date": None})
    return inline_svg(page.getvalue())


def made_on(rows: Sequence[Row]) -> str:
    """Machines, commits and seeds of the rows."""
    told = {
        name: ", ".join(sorted({str(row[key]) for row in rows}))
        for name, key in (("machine", "machine"), ("commit", "commit"), ("seeds", "seed"))
    }
    return "; ".join(f"{name} {text}" for name, text in told.items())
