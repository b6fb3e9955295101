"""Quality of experience over recorded lines: layouts × policies × traces.

    python benchmarks/streaming.py fox=runs/fox/scene.gsyn bonsai=runs/bonsai/scene.gsyn \
        --traces ../shared/data/traces --out docs

Writes OUT/streaming_SCENE.csv with every play, OUT/streaming_SCENE.png with three of them, and
prints the tables of docs/streaming.md. All on a virtual clock, so the figures are those of the
commit, not of the machine (which only adds the time of decoding the base).
"""

import csv
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gsynopsis.cli.stream import flight_around, policy_of
from gsynopsis.evaluate.machine import this_build, this_machine
from gsynopsis.evaluate.playing import STEP, Rendered, Timeline, play
from gsynopsis.evaluate.timelines import plot_timelines
from gsynopsis.model.mixed import MixedModel
from gsynopsis.pack import Assembler, encode, read_gsyn
from gsynopsis.pack.writer import encode_with_account
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import make_renderer
from gsynopsis.stream.catalog import FULL_DB, errors_of
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.session import Plan, Session
from gsynopsis.stream.trace import Trace, read_trace
from gsynopsis.stream.virtual import Link, VirtualLines
from streaming_layouts import files_catalog, play_files

POLICIES = ("fixed", "throughput", "bola", "mpc", "ours")
PLOTTED = ("3g_slow", "puffer_typical", "3g_fast")
LOOKS = [STEP * (n + 1) for n in range(round(30 / STEP))]


@dataclass(frozen=True)
class Settings:
    """What to play.

    Attributes:
        scenes: Scenes as NAME=FILE.
        traces: Folder of recorded lines.
        out: Folder for CSV and plots.
        block: Largest number of anchors of a spatial block.
        round_trip: Seconds.
        width: Width of the pictures that are compared, pixels.
        period: Seconds of a round of the flight.
        only: Names of traces to play; all if empty.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    traces: Path = Path("../shared/data/traces")
    out: Path = Path("docs")
    block: int = 1024
    round_trip: float = 0.05
    width: int = 240
    period: float = 40.0
    only: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """One play."""

    trace: str
    layout: str
    policy: str
    first_s: float
    viewed_10: float
    viewed_30: float
    finished_s: float
    stalled_s: float
    wasted: int


class Scene:
    """A file in all its layouts, and what its pictures are worth."""

    def __init__(self, name: str, path: Path, settings: Settings, renderer: Renderer) -> None:
        self.name = name
        self.settings, self.renderer = settings, renderer
        self.levels: LevelSet = read_gsyn(path)
        meta = dict(self.levels.meta)
        self.flight = flight_around(meta, self.levels.frame, settings.period, settings.width)
        self.show = Rendered(self.flight, renderer, self.levels)
        self.level_db = self.levels_seen()
        self.levels = self.with_quality()
        self.data, _ = encode_with_account(self.levels, block=settings.block)
        count = len(self.levels.levels)
        self.sizes = {k: len(encode(self.levels.upto(k))) for k in range(count)}
        quality = [level.quality.get("psnr_full") for level in self.levels.levels]
        self.errors = [float(e) for e in errors_of(quality)]
        self.base, self.decode_s = self.decode_base()

    def with_quality(self) -> LevelSet:
        """The levels with their PSNR; against the finest level where the file has no figures."""
        if all("psnr_full" in level.quality for level in self.levels.levels):
            return self.levels
        levels = tuple(
            replace(level, quality={"psnr_full": float(np.mean(self.level_db[number]))})
            for number, level in enumerate(self.levels.levels)
        )
        return replace(self.levels, levels=levels)

    def decode_base(self) -> tuple[int, float]:
        """Bytes until the end of level 0, and seconds to decode them, best of five."""
        seconds: list[float] = []
        end = Assembler(self.data[:16384], self.name).index.levels[0].end
        for _ in range(5):
            began = time.perf_counter()
            assembler = Assembler(self.data[:16384], self.name)
            assembler.add_level(self.data[:end])
            assembler.partial()
            seconds.append(time.perf_counter() - began)
        return end, min(seconds)

    def levels_seen(self) -> dict[int, list[float]]:
        """PSNR of each whole level against the finest at all looks of the flight."""
        found: dict[int, list[float]] = {}
        last = len(self.levels.levels) - 1
        for level in range(last):
            part = self.levels.upto(level)
            region = np.full(part.levels[-1].anchors, level, np.uint8)
            model = MixedModel(part, region, self.renderer.device)
            found[level] = [self.show.compare(model, time) for time in LOOKS]
        found[last] = [FULL_DB] * len(LOOKS)
        return found


def our_play(scene: Scene, trace: Trace, policy: str, by_blocks: bool) -> Timeline:
    link = Link(trace, scene.settings.round_trip)
    fetcher = Fetcher(VirtualLines(scene.data, link, scene.name), scene.name, seed=0)
    plan = Plan(policy_of(policy), scene.flight.eyes, by_blocks)  # type: ignore[arg-type]
    session = Session(fetcher, scene.name, plan)
    timeline = play(session, fetcher, scene.flight, scene.show)
    scene.show.forget()
    return timeline


def our_row(scene: Scene, trace: Trace, policy: str, layout: str, t: Timeline) -> Row:
    first = t.first_picture + scene.decode_s
    figures = (first, t.viewed_10, t.viewed_30, t.finished, t.stalled, t.wasted)
    return Row(trace.name, layout, policy, *figures)


def files_row(scene: Scene, trace: Trace, layout: str, policy: str) -> Row:
    finest = max(scene.sizes)
    sizes = scene.sizes if layout == "files" else {finest: scene.sizes[finest]}
    catalog = files_catalog(sizes, scene.errors)
    link = Link(trace, scene.settings.round_trip)
    lines = VirtualLines(bytes(sum(sizes.values())), link, scene.name)
    played = play_files(Fetcher(lines, scene.name, seed=0), catalog, policy_of(policy), 1e4)  # type: ignore[arg-type]
    values: list[float] = []
    for number, moment in enumerate(LOOKS):
        shown = max((k for k, at in played.ready.items() if at <= moment), default=None)
        values.append(0.0 if shown is None else scene.level_db[shown][number])
    first = min(played.ready.values()) + scene.decode_s
    viewed = float(np.mean(values[:20])), float(np.mean(values))
    done = played.ready[finest]
    return Row(trace.name, layout, policy, first, *viewed, done, 0.0, played.wasted)


def plays(scene: Scene, traces: list[Trace]) -> Iterator[Row]:
    for trace in traces:
        shown: dict[str, Timeline] = {}
        for policy in POLICIES:
            timeline = our_play(scene, trace, policy, True)
            shown[policy] = timeline
            yield our_row(scene, trace, policy, "blocks", timeline)
        whole = our_play(scene, trace, "fixed", False)
        yield our_row(scene, trace, "fixed", "levels", whole)
        for policy in POLICIES:
            yield files_row(scene, trace, "files", policy)
        yield files_row(scene, trace, "finest", "fixed")
        if trace.name in PLOTTED:
            path = scene.settings.out / f"streaming_{scene.name}_{trace.name}.png"
            plot_timelines({**shown, "whole levels": whole}, path)


def table(scene: Scene, rows: list[Row]) -> list[str]:
    """One line for each trace: first picture and its share, viewed quality by policy and layout."""
    best_files = ("files", *POLICIES)
    head = ["trace", "first, s", "of whole file", *POLICIES, "levels", "files, best", "finest"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for trace in dict.fromkeys(row.trace for row in rows):
        here = {(r.layout, r.policy): r for r in rows if r.trace == trace}
        ours, finest = here["blocks", "ours"], here["finest", "fixed"]
        cells = [trace, f"{ours.first_s:.2f}", f"{ours.first_s / finest.finished_s:.0%}"]
        values = [here["blocks", policy].viewed_10 for policy in POLICIES]
        top = max(values)
        cells += [f"**{v:.2f}**" if v >= top - 0.005 else f"{v:.2f}" for v in values]
        cells.append(f"{here['levels', 'fixed'].viewed_10:.2f}")
        cells.append(f"{max(here['files', p].viewed_10 for p in best_files[1:]):.2f}")
        cells.append(f"{finest.viewed_10:.2f}")
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def summary(scene: Scene, rows: list[Row]) -> list[str]:
    """Means over all traces by layout and policy."""
    head = [
        "layout",
        "policy",
        "first, s",
        "10 s, dB",
        "30 s, dB",
        "all, s",
        "stalled, s",
        "wasted",
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for layout, policy in dict.fromkeys((r.layout, r.policy) for r in rows):
        here = [r for r in rows if (r.layout, r.policy) == (layout, policy)]
        means = [
            float(np.mean([getattr(r, name) for r in here]))
            for name in ("first_s", "viewed_10", "viewed_30", "finished_s", "stalled_s", "wasted")
        ]
        cells = [layout, policy, *(f"{m:.2f}" for m in means[:-1]), f"{means[-1] / 1024:.0f} KiB"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def main(settings: Settings) -> None:
    traces = [read_trace(path) for path in sorted(settings.traces.glob("*.csv"))]
    traces = [trace for trace in traces if not settings.only or trace.name in settings.only]
    renderer = make_renderer("auto")
    machine, build = this_machine(renderer.device), this_build()
    print(f"{machine.cpu}, {machine.cores} cores, commit {build.commit}, {settings}\n")
    for word in settings.scenes:
        name, _, path = word.partition("=")
        scene = Scene(name, Path(path), settings, renderer)
        rows: list[Row] = []
        for row in plays(scene, traces):
            rows.append(row)
            print(row, file=sys.stderr, flush=True)
        with (settings.out / f"streaming_{name}.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(Row.__dataclass_fields__)
            for row in rows:
                rounded = replace(
                    row, **{k: round(v, 4) for k, v in vars(row).items() if isinstance(v, float)}
                )
                writer.writerow(vars(rounded).values())
        sizes = ", ".join(f"L{k} {s / 1024:.0f} KiB" for k, s in scene.sizes.items())
        print(f"### {name}: base {scene.base / 1024:.0f} KiB of {len(scene.data) / 1024:.0f} KiB, "
              f"decoded in {scene.decode_s * 1e3:.0f} ms; as separate files {sizes}\n")  # fmt: skip
        print("\n".join([*table(scene, rows), "", *summary(scene, rows), ""]), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Settings))
