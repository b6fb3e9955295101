"""Quality of experience over recorded lines: layouts × policies × lines, tuned and held out.

    python -m benchmarks.stream.lines fox=runs/fox bonsai=runs/bonsai

Plays every line from its beginning (all policies and layouts; constants were chosen on these), then
from other moments that nothing was chosen on. Writes streaming_SCENE.csv with every play and those
plots that the page shows beside it, and its part of it. All on a virtual clock: the figures are
those of the commit, not of the machine (which only adds the time of decoding the base).
"""

import csv
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro

from benchmarks.bench import RESULTS, TRACES, put, short_commit
from benchmarks.stream.plays import (
    POLICIES,
    SHORT,
    Conditions,
    Row,
    Scene,
    files_rows,
    our_play,
    our_row,
)
from gsynopsis.evaluation.block_utility import VIEWS
from gsynopsis.playback.play import Timeline
from gsynopsis.playback.plots import plot_timelines
from gsynopsis.render.choose import make_renderer
from gsynopsis.stream.trace import Trace, read_trace, shifted

TIE = 0.01
"""dB; a smaller difference is none."""
QUICK = 1.0
"""Seconds; a line that brings the whole file by then leaves a policy nothing to choose."""
BAR = 0.1
"""The first picture should take at most this share of the whole finest file's time."""
HELD_OUT = "held out"
"""Layout of plays from other beginnings: by blocks."""
EARLY, LATE = 30.0, 15.0
"""Held-out plays begin at least this long after a line's beginning and before its end, seconds."""


@dataclass(frozen=True)
class Settings:
    """Options of the plays.

    Attributes:
        scenes: Scenes as NAME=RUN, where RUN is the folder of an evaluated run.
        traces: Folder of recorded lines.
        page: Page with the marks of this script; CSV and plots go beside it.
        part: Name in the marks, where the page has several.
        how: What all plays share.
        offsets: Held-out moments at which each line begins.
        seed: Seed of these moments.
        only: Names of lines to play; all if empty.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    traces: Path = TRACES
    page: Path = RESULTS / "streaming.md"
    part: str = ""
    how: Conditions = field(default_factory=Conditions)
    offsets: int = 3
    seed: int = 1
    only: tuple[str, ...] = ()


def from_the_beginning(scene: Scene, traces: Sequence[Trace], page: Path) -> Iterator[Row]:
    """Every layout and policy on every line."""
    level_db = scene.level_db()
    for trace in traces:
        shown: dict[str, Timeline] = {}
        line = (trace.name, 0.0)
        for policy in POLICIES:
            shown[policy] = our_play(scene, trace, policy)
            yield our_row(scene, line, "blocks", policy, shown[policy])
        shown["whole levels"] = our_play(scene, trace, "fixed", by_blocks=False)
        yield our_row(scene, line, "levels", "fixed", shown["whole levels"])
        yield from files_rows(scene, trace, level_db)
        plot = page.with_name(f"streaming_{scene.name}_{trace.name}.png")
        if plot.name in page.read_text("utf-8"):
            plot_timelines(shown, plot)


def held_out(scene: Scene, traces: Sequence[Trace], settings: Settings) -> Iterator[Row]:
    """Every policy on blocks, ten seconds from moments that nothing was tuned on."""
    chance = np.random.default_rng(settings.seed)
    for trace in traces:
        for begin in sorted(chance.uniform(EARLY, trace.period - LATE, settings.offsets)):
            offset = round(float(begin), 1)
            for policy in POLICIES:
                shown = our_play(scene, shifted(trace, offset), policy, look=SHORT)
                yield our_row(scene, (trace.name, offset), HELD_OUT, policy, shown)


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]


def first_pictures(scene: Scene, rows: Sequence[Row], traces: Sequence[Trace]) -> str:
    """On how many lines the first picture is soon there, and what no client could beat."""
    count = within = share_ok = possible = hopeless = 0
    for trace in traces:
        here = {(r.layout, r.policy): r for r in rows if r.trace == trace.name}
        if not here:
            continue
        first, whole = here["blocks", "ours"].first_s, here["finest", "fixed"].finished_s
        byte, base, least_whole = scene.least(trace)
        count += 1
        within += first <= 1.0
        share_ok += first <= BAR * whole
        possible += base <= BAR * least_whole
        hopeless += byte > BAR * least_whole
    return f"{within} / {share_ok} / {count - possible} / {hopeless} of {count}"


def layouts_text(plays: Mapping[str, Sequence[Row]]) -> str:
    """Viewed quality over ten seconds by layout, means over all lines; of files the best policy."""
    parts: list[str] = []
    for name, rows in plays.items():
        found: dict[str, list[float]] = {}
        for layout, policy in dict.fromkeys((r.layout, r.policy) for r in begins(rows)):
            if layout == "blocks" and policy != "ours":
                continue
            here = [r.viewed_10 for r in begins(rows) if (r.layout, r.policy) == (layout, policy)]
            found.setdefault(layout, []).append(float(np.mean(here)))
        best = {layout: max(means) for layout, means in found.items()}
        cells = (best[layout] for layout in ("blocks", "levels", "files", "finest"))
        parts.append(f"{name} {' / '.join(f'{value:.2f}' for value in cells)}")
    return (
        "Viewed quality over 10 s, dB, by blocks / whole levels / separate files with their best "
        f"policy / the finest level alone: {'; '.join(parts)}."
    )


def duels(plays: Mapping[str, Sequence[Row]]) -> list[str]:
    """Ours against each other policy from other beginnings, where the file is not there at once."""
    cells: dict[str, list[str]] = {}
    for rows in plays.values():
        by_line: dict[tuple[str, float], dict[str, Row]] = {}
        for row in (row for row in rows if row.layout == HELD_OUT):
            by_line.setdefault((row.trace, row.offset), {})[row.policy] = row
        slow = [by for by in by_line.values() if by["fixed"].finished_s > QUICK]
        for other in POLICIES[:-1]:
            cells.setdefault(other, []).append(duel(slow, other))
    text = [[name, *values] for name, values in cells.items()]
    return [*markdown(["ours against", *plays], text), ""]


def duel(lines: Collection[Mapping[str, Row]], other: str) -> str:
    """Mean difference, and the plays that were won, tied and lost."""
    if not lines:
        return "n/a"
    apart = np.array([by["ours"].viewed_10 - by[other].viewed_10 for by in lines])
    won, lost = int((apart > TIE).sum()), int((apart < -TIE).sum())
    return f"{apart.mean():+.2f} dB, {won} / {len(lines) - won - lost} / {lost}"


def begins(rows: Sequence[Row]) -> list[Row]:
    """The plays from the beginning of each line."""
    return [row for row in rows if row.layout != HELD_OUT]


def played(scene: Scene, traces: Sequence[Trace], settings: Settings) -> list[Row]:
    """Play everything of a scene; all rows, which go into its CSV one by one."""
    folder, rows = settings.page.parent, list[Row]()
    with (folder / f"streaming_{scene.name}.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Row.__dataclass_fields__)
        for source in (
            from_the_beginning(scene, traces, settings.page),
            held_out(scene, traces, settings),
        ):
            for row in source:
                rows.append(row)
                values = {k: round(v, 4) for k, v in vars(row).items() if isinstance(v, float)}
                writer.writerow(vars(replace(row, **values)).values())
                print(row, file=sys.stderr, flush=True)
    return rows


def about(scene: Scene, rows: Sequence[Row], traces: Sequence[Trace]) -> str:
    """A scene's file, and how soon it shows something."""
    return (
        f"{scene.name} (base {scene.base / 1024:.0f} of {len(scene.data) / 1024:.0f} KiB) "
        f"{first_pictures(scene, begins(rows), traces)}"
    )


def page_text(
    made: str, scenes: Sequence[str], plays: Mapping[str, Sequence[Row]], held: str
) -> str:
    """The duels, the layouts, the scenes, and how it was made."""
    text = [*duels(plays), f"{held}: mean difference over 10 s, plays won / tied / lost.", ""]
    text += [layouts_text(plays), ""]
    text += [
        f"Lines with the first picture within 1 s / within {BAR:.0%} of the whole file's time / "
        f"where that is too soon for this base / for any: {'; '.join(scenes)}.",
        "",
    ]
    return "\n".join([*text, made])


def main(settings: Settings) -> None:
    """Play all scenes and write the page."""
    traces = [read_trace(path) for path in sorted(settings.traces.glob("*.csv"))]
    traces = [trace for trace in traces if not settings.only or trace.name in settings.only]
    renderer, how = make_renderer("auto"), settings.how
    made = (
        f"Made at commit {short_commit()}; blocks of at most {how.block} anchors, round trip "
        f"{how.round_trip * 1e3:.0f} ms, a round of the flight in {how.period:g} s, pictures "
        f"{how.width} pixels wide, gains of blocks from {VIEWS} training views."
    )
    plays: dict[str, list[Row]] = {}
    scenes: list[str] = []
    for word in settings.scenes:
        name, _, path = word.partition("=")
        scene = Scene(name, Path(path), how, renderer)
        plays[name] = played(scene, traces, settings)
        scenes.append(about(scene, plays[name], traces))
    held = f"Other beginnings, {settings.offsets} of each line, seed {settings.seed}"
    put(settings.page, __file__, page_text(made, scenes, plays, held), settings.part)
    print(f"wrote {settings.page}")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
