"""`gsynopsis stream`: play a file over a network, real or recorded, and say what was seen."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from gsynopsis.cli.bounds import Backend, bounded
from gsynopsis.cli.defaults import said
from gsynopsis.errors import MissingExtraError, SettingError
from gsynopsis.monitor.display import ticking
from gsynopsis.runs.folder import find_run
from gsynopsis.stream.download import is_address
from gsynopsis.stream.fetch import DEADLINE
from gsynopsis.stream.policy import PolicyName

if TYPE_CHECKING:
    from gsynopsis.playback.play import Timeline
    from gsynopsis.render.base import Renderer
    from gsynopsis.stream.fetch import Fetcher
    from gsynopsis.stream.http import HttpSource

SECONDS = (0.1, 3600)
"""Range of the seconds of a play, and of a round of the flight."""
WIDTH = (8, 4096)
"""Range of the width of compared renders, pixels."""


@dataclass(frozen=True)
class Stream:
    """Stream a file while flying around the scene; writes what a viewer would have seen, and when.

    Attributes:
        source: An http address, or a .gsyn file or the folder of a run (which need --trace).
        out: Folder for timeline.json, timeline.csv and timeline.png.
        trace: Recorded line (CSV `time_s,mbit_per_s`): the file is played over it on a virtual
            clock.
        policy: Rule that chooses what to ask for next.
        whole_levels: Ask for whole levels instead of blocks.
        round_trip: Seconds from a request to its answer on the recorded line.
        seconds: Length of the play.
        period: Seconds of one round of the flight.
        timeout: Seconds by which the whole file has to be there.
        width: Width of the images that are compared, pixels.
        renderer: Rasteriser; auto takes CUDA where it is there.
        json: Print the totals as JSON.
        quiet: No progress.
    """

    source: Positional[str]
    out: Path
    trace: Annotated[Path | None, said("none, over the network")] = None
    policy: PolicyName = "ours"
    whole_levels: bool = False
    round_trip: float = 0.05
    seconds: float = 30.0
    period: float = 40.0
    timeout: float = DEADLINE
    width: int = 320
    renderer: Backend = "auto"
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Play and write."""
        bounded("--seconds", self.seconds, *SECONDS)
        bounded("--period", self.period, *SECONDS)
        bounded("--width", self.width, *WIDTH)
        bounded("--round-trip", self.round_trip, 0, 60)
        bounded("--timeout", self.timeout, 1, 1e6)
        # Before the clock starts: these take longer than many a stream.
        from gsynopsis.playback.play import write_timeline
        from gsynopsis.playback.plots import plot_timeline
        from gsynopsis.render.choose import make_renderer

        renderer = make_renderer(self.renderer, budgeted=True)
        fetcher = self._fetcher()
        try:
            timeline = self._play(fetcher, renderer)
        finally:
            fetcher.close()

        paths = [*write_timeline(timeline, self.out), plot_timeline(timeline, self.out)]
        if self.json:
            print(json.dumps({**totals(timeline), "files": [str(p) for p in paths]}, indent=2))
        else:
            print("\n".join([in_words(timeline), *map(str, paths)]))
        return 0

    def _play(self, fetcher: "Fetcher", renderer: "Renderer") -> "Timeline":
        """Stream and fly. The file's own header says where, so that comes first."""
        from gsynopsis.jobs.simulate_stream import POLICIES, flight_around
        from gsynopsis.playback.play import Rendered, play
        from gsynopsis.stream.session import Session, SessionOptions, still

        options = SessionOptions(POLICIES[self.policy], still, not self.whole_levels)
        session = Session(fetcher, self.source, options)
        while not session.events:
            session.advance(float("inf"))
        flight = flight_around(session.meta, session.frame(), self.period, self.width)
        session.options = replace(options, eyes=flight.eyes)
        show = Rendered(flight, renderer)
        with ticking("streaming", quiet=self.quiet) as tick:
            return play(
                session,
                fetcher,
                flight,
                show,
                seconds=self.seconds,
                tick=lambda time: tick(round(time * 10), round(self.seconds * 10)),
            )

    def _fetcher(self) -> "Fetcher":
        from gsynopsis.container.reader import read_bytes
        from gsynopsis.stream.fetch import Fetcher
        from gsynopsis.stream.trace import read_trace
        from gsynopsis.stream.transport import ThreadTransport
        from gsynopsis.stream.virtual import Link, VirtualTransport

        if self.trace is not None:
            if is_address(self.source):
                advice = "serve it with `gsynopsis serve --trace`, or give the file's path"
                raise SettingError("--trace", found=f"an address ({self.source})", advice=advice)
            link = Link(read_trace(self.trace), self.round_trip)
            # What `check` refuses is not played, not even its good levels.
            path = Path(self.source)
            path = find_run(path).file if path.is_dir() else path
            transport = VirtualTransport(read_bytes(path), link, self.source)
            return Fetcher(transport, self.source, seed=0, deadline=self.timeout)
        if not is_address(self.source):
            raise SettingError("--trace", found="none", expected="a recorded line for a local file")
        transport = ThreadTransport(http_source(self.source))
        return Fetcher(transport, self.source, deadline=self.timeout)


def http_source(address: str) -> "HttpSource":
    """A source on a web server.

    Raises:
        MissingExtraError: httpx is not installed.
    """
    try:
        from gsynopsis.stream.http import HttpSource
    except ImportError as error:
        raise MissingExtraError("httpx", "stream") from error
    return HttpSource(address)


def totals(timeline: "Timeline") -> dict[str, float]:
    """The figures of a play, seconds, bytes and decibels."""
    return {
        "first_picture_s": timeline.first_picture,
        "finished_s": timeline.finished,
        "stalled_s": timeline.stalled,
        "received_bytes": timeline.received,
        "wasted_bytes": timeline.wasted,
        "retries": timeline.retries,
        "levels": timeline.levels,
        "levels_total": timeline.levels_total,
        "viewed_10s_db": timeline.viewed_10,
        "viewed_30s_db": timeline.viewed_30,
    }


def in_words(timeline: "Timeline") -> str:
    """The figures of a play in three lines."""
    t = timeline
    levels = f"{t.levels} levels"
    if t.levels < t.levels_total:
        levels = f"{t.levels} of {t.levels_total} levels, the file is a prefix"
    return (
        f"{levels}\n"
        f"first picture after {t.first_picture:.2f} s, all after {t.finished:.2f} s, "
        f"{t.received / 2**20:.2f} MiB in the play, {t.wasted:,} bytes wasted, "
        f"{t.retries} retries, stalled {t.stalled:.1f} s\n"
        f"viewed quality against the full model: {t.viewed_10:.2f} dB over 10 s, "
        f"{t.viewed_30:.2f} dB over 30 s"
    )
