"""Plots of plays: level, bytes and quality over time."""

# Matplotlib leaves **kwargs untyped:
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping
from pathlib import Path

from gsynopsis.errors import MissingExtraError
from gsynopsis.evaluate.playing import Timeline
from gsynopsis.evaluate.publish import published

try:
    from matplotlib.figure import Figure
except ImportError as error:
    raise MissingExtraError("matplotlib", "plots") from error

PANELS = (
    ("psnr", "quality shown, dB"),
    ("level", "mean level shown"),
    ("received", "MiB received"),
)


def plot_timeline(timeline: Timeline, out: Path) -> Path:
    """The timeline as `timeline.png` under a folder."""
    return plot_timelines({"": timeline}, out / "timeline.png")


def plot_timelines(plays: Mapping[str, Timeline], path: Path) -> Path:
    """Several plays in the same three panels, as PNG."""
    figure = Figure(figsize=(9.5, 3.0), layout="constrained")
    for number, (field, title) in enumerate(PANELS, start=1):
        axes = figure.add_subplot(1, len(PANELS), number)
        for name, play in plays.items():
            times = [look.time for look in play.looks]
            values = [float(getattr(look, field)) for look in play.looks]
            if field == "received":
                values = [value / 2**20 for value in values]
            axes.step(times, values, where="pre", label=name or None, linewidth=1.3)
        if len(plays) == 1:
            for play in plays.values():
                axes.axvline(play.first_picture, linewidth=0.8, linestyle=":", color="0.4")
        axes.set_xlabel("seconds")
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.25)
        if number == 1 and len(plays) > 1:
            axes.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    with published(path) as draft:
        figure.savefig(draft, dpi=110, format="png")
    return path
