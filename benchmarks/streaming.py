"""Quality of experience over recorded lines: layouts × policies × lines, tuned and held out.

    python benchmarks/streaming.py fox=runs/fox bonsai=runs/bonsai --page docs/streaming.md

Plays every line from its beginning (all policies and layouts; constants were chosen on these), then
from other moments that nothing was chosen on. Writes streaming_SCENE.csv with every play and plots
beside the page, and the tables into it. All on a virtual clock: the figures are those of the
commit, not of the machine (which only adds the time of decoding the base).
"""

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro

from gsynopsis.evaluate.gains import VIEWS
from gsynopsis.evaluate.playing import Timeline
from gsynopsis.evaluate.timelines import plot_timelines
from gsynopsis.render.choose import make_renderer
from gsynopsis.stream.trace import Trace, read_trace, shifted
from marked_pages import put, short_commit
from streaming_plays import POLICIES, SHORT, Conditions, Row, Scene, files_rows, our_play, our_row

PLOTTED = ("3g_slow", "puffer_typical", "3g_fast")
TIE = 0.01
"""dB; a smaller difference is none."""
QUICK = 1.0
"""Seconds; a line that brings the whole file by then leaves a policy nothing to choose."""
BAR = 0.1
"""The first picture should take at most this share of the whole finest file's time."""
EARLY, LATE = 30.0, 15.0
"""Held-out plays begin so many seconds after a line's beginning and before its end."""


@dataclass(frozen=True)
class Settings:
    """What to play.

    Attributes:
        scenes: Scenes as NAME=RUN, where RUN is the folder of an evaluated run.
        traces: Folder of recorded lines.
        page: Page with the marks of this script; CSV and plots go beside it.
        how: What all plays share.
        offsets: Held-out moments at which each line begins.
        seed: Of these moments.
        only: Names of lines to play; all if empty.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    traces: Path = Path("../shared/data/traces")
    page: Path = Path("docs/streaming.md")
    how: Conditions = field(default_factory=Conditions)
    offsets: int = 3
    seed: int = 1
    only: tuple[str, ...] = ()


def from_the_beginning(scene: Scene, traces: Sequence[Trace], folder: Path) -> Iterator[Row]:
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
        if trace.name in PLOTTED:
            plot_timelines(shown, folder / f"streaming_{scene.name}_{trace.name}.png")


def held_out(scene: Scene, traces: Sequence[Trace], settings: Settings) -> Iterator[Row]:
    """Every policy on blocks, ten seconds from moments that nothing was tuned on."""
    chance = np.random.default_rng(settings.seed)
    for trace in traces:
        for begin in sorted(chance.uniform(EARLY, trace.period - LATE, settings.offsets)):
            offset = round(float(begin), 1)
            for policy in POLICIES:
                played = our_play(scene, shifted(trace, offset), policy, look=SHORT)
                yield our_row(scene, (trace.name, offset), "held out", policy, played)


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]


def first_pictures(scene: Scene, rows: Sequence[Row], traces: Sequence[Trace]) -> list[str]:
    """When the first picture is there, and what no client could beat."""
    cells: list[list[str]] = []
    within = share_ok = possible = hopeless = 0
    for trace in traces:
        here = {(r.layout, r.policy): r for r in rows if r.trace == trace.name}
        if not here:
            continue
        first, whole = here["blocks", "ours"].first_s, here["finest", "fixed"].finished_s
        byte, base, least_whole = scene.least(trace)
        within += first <= 1.0
        share_ok += first <= BAR * whole
        possible += base <= BAR * least_whole
        hopeless += byte > BAR * least_whole
        shares = [first / whole, base / least_whole, byte / least_whole]
        cells.append([trace.name, f"{first:.2f}", f"{whole:.2f}", *(f"{s:.0%}" for s in shares)])
    count = len(cells)
    head = ["line", "first picture, s", "whole finest file, s", "share", "least", "one byte"]
    text = (
        f"First picture within 1 s on {within} of {count} lines, and within {BAR:.0%} of the whole "
        f"file's time on {share_ok}; no client with this base can be within {BAR:.0%} on "
        f"{count - possible} of {count}, and none with any base, be it one byte, on {hopeless}."
    )
    return [*markdown(head, cells), "", text, ""]


def qualities(rows: Sequence[Row]) -> list[str]:
    """Viewed quality over ten seconds by line, policy and layout."""
    cells: list[list[str]] = []
    for trace in dict.fromkeys(row.trace for row in rows):
        here = {(r.layout, r.policy): r for r in rows if r.trace == trace}
        values = [here["blocks", policy].viewed_10 for policy in POLICIES]
        top = max(values) - TIE
        line = [trace, *(f"**{v:.2f}**" if v >= top else f"{v:.2f}" for v in values)]
        line.append(f"{here['levels', 'fixed'].viewed_10:.2f}")
        line.append(f"{max(here['files', p].viewed_10 for p in POLICIES):.2f}")
        cells.append([*line, f"{here['finest', 'fixed'].viewed_10:.2f}"])
    return [*markdown(["line", *POLICIES, "levels", "files, best", "finest"], cells), ""]


def summary(rows: Sequence[Row]) -> list[str]:
    """Means over all lines by layout and policy."""
    names = ("first_s", "viewed_10", "viewed_30", "finished_s", "stalled_s", "wasted")
    cells: list[list[str]] = []
    for layout, policy in dict.fromkeys((r.layout, r.policy) for r in rows):
        here = [r for r in rows if (r.layout, r.policy) == (layout, policy)]
        means = [float(np.mean([getattr(r, name) for r in here])) for name in names]
        line = [layout, policy, *(f"{m:.2f}" for m in means[:-1])]
        cells.append([*line, f"{means[-1] / 1024:.0f} KiB"])
    head = ["layout", "policy", "first, s", "10 s, dB", "30 s, dB", "all, s", "stalled, s"]
    return [*markdown([*head, "wasted"], cells), ""]


def duels(rows: Sequence[Row]) -> list[str]:
    """Ours against each other policy on held-out lines, those that are over at once apart."""
    plays: dict[tuple[str, float], dict[str, Row]] = {}
    for row in rows:
        plays.setdefault((row.trace, row.offset), {})[row.policy] = row
    quick = {line for line, by in plays.items() if by["fixed"].finished_s <= QUICK}
    cells: list[list[str]] = []
    for name, lines in (
        (f"file not there within {QUICK:g} s", [line for line in plays if line not in quick]),
        ("file there by then", sorted(quick)),
    ):
        for other in POLICIES[:-1]:
            if not lines:
                continue
            apart = np.array(
                [plays[n]["ours"].viewed_10 - plays[n][other].viewed_10 for n in lines]
            )
            won, lost = int((apart > TIE).sum()), int((apart < -TIE).sum())
            counts = [str(n) for n in (len(lines), won, len(lines) - won - lost, lost)]
            figures = [f"{apart.mean():+.2f}", f"{apart.min():+.2f}", f"{apart.max():+.2f}"]
            cells.append([name, other, *counts, *figures])
    head = ["held-out plays", "ours against", "plays", "won", "tied", "lost", "mean, dB"]
    return [*markdown([*head, "worst", "best"], cells), ""]


def scene_text(scene: Scene, traces: Sequence[Trace], settings: Settings) -> list[str]:
    """Play everything of a scene; its part of the page."""
    folder, rows = settings.page.parent, list[Row]()
    with (folder / f"streaming_{scene.name}.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Row.__dataclass_fields__)
        for source in (
            from_the_beginning(scene, traces, folder),
            held_out(scene, traces, settings),
        ):
            for row in source:
                rows.append(row)
                values = {k: round(v, 4) for k, v in vars(row).items() if isinstance(v, float)}
                writer.writerow(vars(replace(row, **values)).values())
                print(row, file=sys.stderr, flush=True)
    begun = [row for row in rows if row.layout != "held out"]
    sizes = ", ".join(f"L{k} {s / 1024:.0f} KiB" for k, s in scene.sizes.items())
    title = (
        f"### {scene.name}: base {scene.base / 1024:.0f} KiB of {len(scene.data) / 1024:.0f} KiB, "
        f"decoded in {scene.decode_s * 1e3:.0f} ms; as separate files {sizes}"
    )
    return [
        *(title, "", *first_pictures(scene, begun, traces)),
        *("From the beginning of each line, dB over 10 s:", "", *qualities(begun)),
        *("Means over the lines:", "", *summary(begun)),
        *(f"Other beginnings, {settings.offsets} of each line, seed {settings.seed}:", ""),
        *duels([row for row in rows if row.layout == "held out"]),
    ]


def main(settings: Settings) -> None:
    """Play all scenes and write the page."""
    traces = [read_trace(path) for path in sorted(settings.traces.glob("*.csv"))]
    traces = [trace for trace in traces if not settings.only or trace.name in settings.only]
    renderer, how = make_renderer("auto"), settings.how
    text = [
        f"Commit {short_commit()}; blocks of at most {how.block} anchors, round trip "
        f"{how.round_trip * 1e3:.0f} ms, a round of the flight in {how.period:g} s, pictures "
        f"{how.width} pixels wide, gains of blocks from {VIEWS} training views.",
        "",
    ]
    for word in settings.scenes:
        name, _, path = word.partition("=")
        text += scene_text(Scene(name, Path(path), how, renderer), traces, settings)
    put(settings.page, "streaming.py", "\n".join(text))
    print(f"wrote {settings.page}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
