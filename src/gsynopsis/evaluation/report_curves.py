"""The curves of the report as inline SVG: quality over bytes, one protocol per figure."""

# Matplotlib leaves **kwargs untyped:
# pyright: reportUnknownMemberType=false

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from gsynopsis.errors import MissingExtraError
from gsynopsis.evaluation.report import LevelScore

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
except ImportError as error:
    raise MissingExtraError("matplotlib", "plots") from error

Protocol = Literal["full", "own"]
INKS = {"#010101": "var(--ink)", "#020202": "var(--faint)", "#030303": "var(--accent)"}
"""Matplotlib draws in these stand-in colours; the page's style sheet gives the real ones, so
that one figure serves light and dark."""
INK, FAINT, ACCENT = INKS
STYLE: dict[Any, object] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 11,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "xtick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.color": FAINT,
    "ytick.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.alpha": 0.25,
}
SIZE = (8.6, 3.3)


@dataclass(frozen=True)
class Panel:
    """One axis of a figure: which measure, and its name with the unit."""

    measure: Literal["psnr", "ssim"]
    title: str


PANELS = (Panel("psnr", "PSNR, dB"), Panel("ssim", "SSIM"))


def quality_curves(levels: Sequence[LevelScore], protocol: Protocol) -> str:
    """PSNR and SSIM over cumulative compact bytes, as one SVG element without outside links."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": protocol}):
        figure = Figure(figsize=SIZE)
        # A layout that Matplotlib finds is drawn twice.
        figure.subplots_adjust(left=0.065, right=0.985, bottom=0.16, top=0.9, wspace=0.17)
        for number, panel in enumerate(PANELS, start=1):
            _draw(figure.add_subplot(1, len(PANELS), number), levels, protocol, panel)
        page = io.StringIO()
        figure.savefig(page, format="svg", transparent=True, metadata={"Date": None})
    return inline_svg(page.getvalue())


def inline_svg(document: str) -> str:
    """A matplotlib SVG file as an element that can stand in a page: themed, no header, no URLs."""
    element = document[document.index("<svg") :]
    # A style element inside an inline SVG would apply to the whole page.
    element = re.sub(r"<(metadata|style)\b.*?</\1>", "", element, flags=re.DOTALL)
    element = re.sub(r' xmlns(:\w+)?="[^"]*"', "", element)
    element = re.sub(r'<g id="[^"]*"', "<g", element)
    element = re.sub(r'(<svg[^>]*?) width="[^"]*pt"', r"\1", element)
    element = re.sub(r'(<svg[^>]*?) height="[^"]*pt"', r"\1", element)
    element = element.replace("xlink:href", "href")
    for stand_in, variable in INKS.items():
        element = element.replace(stand_in, variable)
    return element


def _draw(axes: Axes, levels: Sequence[LevelScore], protocol: Protocol, panel: Panel) -> None:
    x = [score.sizes.bytes_compact / 2**20 for score in levels]
    name, title = f"{panel.measure}_{protocol}", panel.title
    if name == "psnr_full" and levels[-1].quality.masked:
        name, title = "psnr_masked", f"{title}, inside the masks"
    y = [float(getattr(score.quality, name)) for score in levels]
    axes.plot(x, y, color=ACCENT, linewidth=2, marker="o", markersize=6, clip_on=False)
    for score, left, up in zip(levels, x, y, strict=True):
        axes.annotate(
            f"L{score.level}", (left, up), (7, -14), textcoords="offset points", ha="center"
        )
    axes.margins(x=0.1, y=0.2)
    axes.set_xlim(left=0)
    if panel.measure == "ssim":
        axes.set_ylim(top=min(1.0, axes.get_ylim()[1]))
    axes.set_xlabel("cumulative size, MiB (compact)")
    axes.set_title(title, loc="left", fontsize=11, fontweight="bold")
