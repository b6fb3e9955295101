"""Plots of plays: level, bytes and quality over time."""

# Matplotlib leaves **kwargs untyped:
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping
from pathlib import Path

from gsynopsis.errors import MissingExtraError
from gsynopsis.files import published
from gsynopsis.playback.play import Timeline

try:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
except ImportError as error:
    raise MissingExtraError("matplotlib", "plots") from error

PANELS = (
    ("psnr", "quality shown, dB against all levels"),
    ("level", "mean level shown"),
    ("received", "MiB received"),
)
APART = 0.07
"""Share of the panel's width within which events share a line and a label."""
RIGHT = 0.85
"""Share of it from which on labels stand to the left of their lines."""


def plot_timeline(timeline: Timeline, out: Path) -> Path:
    """The timeline as `timeline.png` under a folder."""
    return plot_timelines({"": timeline}, out / "timeline.png")


def plot_timelines(plays: Mapping[str, Timeline], path: Path) -> Path:
    """Several plays in the same three panels, as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with published(path) as draft:
        timelines_figure(plays).savefig(draft, dpi=110, format="png")
    return path


def timelines_figure(plays: Mapping[str, Timeline]) -> Figure:
    """The same as a figure; one play alone has its events and what its levels are worth."""
    figure = Figure(figsize=(9.5, 3.0), layout="constrained")
    for number, (field, title) in enumerate(PANELS, start=1):
        axes = figure.add_subplot(1, len(PANELS), number)
        for name, play in plays.items():
            times = [look.time for look in play.looks]
            values = [float(getattr(look, field)) for look in play.looks]
            if field == "received":
                values = [value / 2**20 for value in values]
            axes.step(times, values, where="pre", label=name or None, linewidth=1.3)
        axes.set_xlabel("seconds")
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.25)
        if field == "level":
            _name_levels(axes, plays)
        if len(plays) == 1:
            for play in plays.values():
                _mark_events(axes, play, labels=number == 1)
        elif number == 1:
            axes.legend(fontsize=7)
    return figure


def _name_levels(axes: Axes, plays: Mapping[str, Timeline]) -> None:
    """Levels by name on the axis, with their quality where one play alone is shown."""
    most = max((play.levels for play in plays.values()), default=1)
    names = ["none", *(f"L{level}" for level in range(most))]
    if len(plays) == 1:
        (play,) = plays.values()
        for level, value in enumerate(play.level_db):
            names[level + 1] += "" if value is None else f"\n{value:.1f} dB"
        if play.level_db_size:
            axes.set_ylabel(f"dB: photos of {play.level_db_size}", fontsize=7)
    axes.set_yticks(range(-1, most), names, fontsize=8)
    axes.set_ylim(-1.15, most - 0.85)


def _mark_events(axes: Axes, play: Timeline, *, labels: bool) -> None:
    """Lines where something became ready; all of them lie within the panel."""
    events = [(play.first_picture, "first picture")]
    ready = [event for event in play.events if event.name == "level-ready" and event.level > 0]
    events += [(event.time, f"L{event.level}") for event in ready]
    events.append((play.finished, "all"))
    end = 1.02 * max([time for time, _ in events] + [look.time for look in play.looks])
    axes.set_xlim(0, end)
    groups: list[tuple[float, list[str]]] = []
    for time, name in events:
        if groups and time - groups[-1][0] < APART * end:
            groups[-1][1].append(name)
        else:
            groups.append((time, [name]))
    for time, names in groups:
        axes.axvline(time, linewidth=0.8, linestyle=":", color="0.4")
        if labels:
            side = "right" if time > RIGHT * end else "left"
            axes.text(
                time,
                0.03,
                f" {', '.join(names)} ",
                transform=axes.get_xaxis_transform(),
                rotation=90,
                ha=side,
                va="bottom",
                fontsize=7,
                color="0.3",
            )
