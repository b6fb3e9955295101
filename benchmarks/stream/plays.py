"""A file over a recorded line, played: the scene in all its layouts, and one row for each play."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.stream.layouts import files_catalog, play_files
from gsynopsis.container import Assembler, encode, read_gsyn
from gsynopsis.container.notes.block_utility import utility_text
from gsynopsis.container.writer import encode_with_account
from gsynopsis.evaluation.block_utility import cameras_of, measure_utilities
from gsynopsis.jobs.simulate_stream import POLICIES as OURS
from gsynopsis.jobs.simulate_stream import flight_around
from gsynopsis.model.multi_level import MultiLevelModel
from gsynopsis.playback.play import STEP, Rendered, Timeline, play
from gsynopsis.records import UTILITY_NOTE, LevelSet
from gsynopsis.render.base import Renderer
from gsynopsis.runs.folder import find_run, scene_of
from gsynopsis.scene.load import load_scene
from gsynopsis.stream.catalog import FULL_DB, errors_of
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.session import Session, SessionOptions
from gsynopsis.stream.trace import Trace
from gsynopsis.stream.virtual import Link, VirtualTransport
from research.policies import l3gs, mpc_viewport

RULES = {**OURS, "mpc-viewport": mpc_viewport, "l3gs": l3gs}
POLICIES = ("fixed", "throughput", "bola", "mpc", "mpc-viewport", "l3gs", "ours")
LOOKS = [STEP * (n + 1) for n in range(round(30 / STEP))]
WHOLE, SHORT = (30.0, STEP), (10.0, STEP / 2)
"""Length of a play and seconds between two looks."""
TURNS = 2
"""Round trips until the first byte: a new connection's set-up, and the request."""


@dataclass(frozen=True)
class Conditions:
    """Conditions that all plays share.

    Attributes:
        block: Largest number of anchors of a spatial block.
        round_trip: Seconds.
        width: Width of the compared renders, pixels.
        period: Seconds of a round of the flight.
    """

    block: int = 512
    round_trip: float = 0.05
    width: int = 240
    period: float = 40.0


@dataclass(frozen=True)
class Row:
    """One play."""

    trace: str
    offset: float
    layout: str
    policy: str
    first_s: float
    viewed_10: float
    viewed_30: float
    finished_s: float
    stalled_s: float
    wasted: int


class Scene:
    """A run's file in all its layouts, and the quality of its images."""

    def __init__(self, name: str, path: Path, how: Conditions, renderer: Renderer) -> None:
        self.name, self.how, self.renderer = name, how, renderer
        self.levels: LevelSet = read_gsyn(find_run(path).file)
        if not all("psnr_full" in level.quality for level in self.levels.levels):
            raise SystemExit(f"{path}: no PSNR of its levels; run `gsynopsis evaluate` first")
        meta = dict(self.levels.meta)
        self.flight = flight_around(meta, self.levels.frame, how.period, how.width)
        self.show = Rendered(self.flight, renderer, self.levels)
        self.data = self.packed(path)
        count = len(self.levels.levels)
        self.sizes = {k: len(encode(self.levels.upto(k))) for k in range(count)}
        quality = [level.quality["psnr_full"] for level in self.levels.levels]
        self.errors = [float(e) for e in errors_of(quality)]
        self.base, self.decode_s = self.decode_base()

    def packed(self, path: Path) -> bytes:
        """The file in blocks of the wanted size, with what each adds in the training views."""
        plain = encode_with_account(self.levels, block=self.how.block)[0]
        assembler = Assembler(plain, self.name)
        for _ in self.levels.levels:
            assembler.add_level(plain)
        root, scale, split = scene_of(find_run(path), None, None, None)
        cameras = cameras_of(load_scene(root, split), scale)
        note = {UTILITY_NOTE: utility_text(measure_utilities(assembler, cameras, self.renderer))}
        noted = replace(self.levels, meta={**self.levels.meta, **note})
        return encode_with_account(noted, block=self.how.block)[0]

    def decode_base(self) -> tuple[int, float]:
        """Bytes until the end of level 0, and seconds to decode them, best of five."""
        seconds: list[float] = []
        end = Assembler(self.data, self.name).index.levels[0].end
        for _ in range(5):
            began = time.perf_counter()
            assembler = Assembler(self.data, self.name)
            assembler.add_level(self.data[:end])
            assembler.partial()
            seconds.append(time.perf_counter() - began)
        return end, min(seconds)

    def level_db(self) -> dict[int, list[float]]:
        """PSNR of each whole level against the finest at all looks of the flight."""
        found: dict[int, list[float]] = {}
        last = len(self.levels.levels) - 1
        for level in range(last):
            part = self.levels.upto(level)
            region = np.full(part.levels[-1].anchors, level, np.uint8)
            model = MultiLevelModel(part, region, self.renderer.device)
            found[level] = [self.show.compare(model, time) for time in LOOKS]
        found[last] = [FULL_DB] * len(LOOKS)
        return found

    def least(self, trace: Trace) -> tuple[float, float, float]:
        """Least seconds of any client to a first byte, to the base, and to the finest file."""
        began = TURNS * self.how.round_trip

        def until(size: int) -> float:
            return trace.time_of(trace.bytes_by(began) + size)

        return until(1), until(self.base), until(self.sizes[max(self.sizes)])


def our_play(
    scene: Scene,
    trace: Trace,
    policy: str,
    by_blocks: bool = True,
    look: tuple[float, float] = WHOLE,
) -> Timeline:
    link = Link(trace, scene.how.round_trip)
    fetcher = Fetcher(VirtualTransport(scene.data, link, scene.name), scene.name, seed=0)
    plan = SessionOptions(RULES[policy], scene.flight.eyes, by_blocks)
    session = Session(fetcher, scene.name, plan)
    timeline = play(session, fetcher, scene.flight, scene.show, seconds=look[0], step=look[1])
    scene.show.forget()
    return timeline


def our_row(scene: Scene, line: tuple[str, float], layout: str, policy: str, t: Timeline) -> Row:
    first = t.first_picture + scene.decode_s
    figures = (first, t.viewed_10, t.viewed_30, t.finished, t.stalled, t.wasted)
    return Row(*line, layout, policy, *figures)


def files_rows(scene: Scene, trace: Trace, level_db: dict[int, list[float]]) -> Iterator[Row]:
    """Levels as separate files by every policy, and the finest one alone."""
    finest = max(scene.sizes)
    for layout, policy in [*(("files", policy) for policy in POLICIES), ("finest", "fixed")]:
        sizes = scene.sizes if layout == "files" else {finest: scene.sizes[finest]}
        catalog = files_catalog(sizes, scene.errors)
        link = Link(trace, scene.how.round_trip)
        lines = VirtualTransport(bytes(sum(sizes.values())), link, scene.name)
        rule = RULES[policy]
        played = play_files(Fetcher(lines, scene.name, seed=0), catalog, rule, 1e4)
        values: list[float] = []
        for number, moment in enumerate(LOOKS):
            shown = max((k for k, at in played.ready.items() if at <= moment), default=None)
            values.append(0.0 if shown is None else level_db[shown][number])
        first = min(played.ready.values()) + scene.decode_s
        viewed = float(np.mean(values[:20])), float(np.mean(values))
        figures = (first, *viewed, played.ready[finest], 0.0, played.wasted)
        yield Row(trace.name, 0.0, layout, policy, *figures)
