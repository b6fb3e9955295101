"""A headless client: flies while a file streams, and records the quality of its view."""

import csv
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from gsynopsis.evaluation.metrics import Image8, psnr
from gsynopsis.evaluation.protocols import LevelRenderer, eye_of
from gsynopsis.files import published
from gsynopsis.model.multi_level import MultiLevelModel
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.stream.catalog import FULL_DB, Key
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.session import Event, Session
from gsynopsis.stream.views import ViewPose, covered, extrapolate

STEP = 0.5
"""Default of the seconds between two samples of the image."""
LOOK_BACK = 0.1
"""Seconds of past motion from which the client guesses where the camera goes."""
SIZE_LENGTH = 24
"""Characters of an image's size that are believed."""
STALL = 1.0
"""Seconds without a new byte, before all is there, that count as a stall."""


@dataclass(frozen=True)
class Flight:
    """A camera over time; it flies round and round.

    Attributes:
        cameras: Cameras at equal distances in time.
        period: Seconds of one round.
    """

    cameras: tuple[Camera, ...]
    period: float

    def number(self, time: float) -> int:
        """Index of the camera nearest to a time."""
        return round(time / self.period * len(self.cameras)) % len(self.cameras)

    def at(self, time: float) -> Camera:
        """The camera at a time, the nearest there is."""
        return self.cameras[self.number(time)]

    def eye(self, time: float) -> ViewPose:
        """The same for a policy."""
        return eye_of(self.at(time))

    def eyes(self, time: float, ahead: Sequence[float]) -> Sequence[ViewPose]:
        """Cameras that a client expects from the motion so far: it does not know the flight."""
        return extrapolate(self.eye(time - LOOK_BACK), self.eye(time), LOOK_BACK, ahead)


@dataclass(frozen=True)
class Look:
    """View of a client at one moment.

    Attributes:
        time: Seconds.
        level: Mean level of the image, by area; -1 before the first image.
        received: Bytes so far.
        psnr: Against the full model, dB, at most `FULL_DB`; 0 before the first image.
    """

    time: float
    level: float
    received: int
    psnr: float


@dataclass(frozen=True)
class Timeline:
    """One play.

    Attributes:
        first_picture: Seconds until the base was there and decoded.
        finished: Seconds until all was there, which may be after the play.
        stalled: Seconds of stalls after the first image.
        received: Bytes.
        wasted: Bytes that arrived and are of no use (twice, or never complete).
        retries: Requests that were repeated.
        viewed_10: Mean of `psnr` over the first ten seconds, dB.
        viewed_30: Over the first thirty.
        levels: Levels that the file holds.
        levels_total: Levels that its tables list; more if it is a prefix.
        level_db: PSNR of each level against photos, as the file states it, dB.
        level_db_size: Size of these photos, empty if the file does not say.
        looks: At equal steps of time.
        events: What became ready, when.
    """

    first_picture: float
    finished: float
    stalled: float
    received: int
    wasted: int
    retries: int
    viewed_10: float
    viewed_30: float
    levels: int
    levels_total: int
    level_db: tuple[float | None, ...]
    level_db_size: str
    looks: tuple[Look, ...]
    events: tuple[Event, ...]


class Show(Protocol):
    """Quality of a session's blocks. Noting them is quick, measuring may wait till the end."""

    def note(self, session: Session, time: float) -> None:
        """Remember the held items at a time."""
        ...

    def psnr(self, time: float) -> float:
        """PSNR against the full model, dB, of the items remembered for that time."""
        ...


def play(
    session: Session,
    fetcher: Fetcher,
    flight: Flight,
    show: Show,
    *,
    seconds: float = 30.0,
    step: float = STEP,
    tick: Callable[[float], None] | None = None,
) -> Timeline:
    """Stream and fly for some seconds; then go on until all is there, without looking.

    Args:
        session: It may have its header, not more.
        fetcher: The session's; the caller closes it.
        flight: The camera; the session's eyes are usually `flight.eyes`.
        show: Measures images.
        seconds: Length of the play.
        step: Seconds between two looks.
        tick: Called with the seconds played.
    """
    moments = [step * (n + 1) for n in range(round(seconds / step))]
    looks = list(_looks(session, fetcher, flight, show, moments, tick))
    received, wasted = fetcher.received, max(0, fetcher.received - session.useful - fetcher.kept)
    while not session.complete and session.advance(float("inf")):
        pass
    looks = [
        Look(k.time, k.level, k.received, min(FULL_DB, show.psnr(k.time)) if k.level >= 0 else 0.0)
        for k in looks
    ]
    base = next(e.time for e in session.events if e.name == "base-ready")
    finished = session.events[-1].time
    values = np.array([look.psnr for look in looks])
    level_db, size = manifest_quality(session)
    return Timeline(
        first_picture=base,
        finished=finished,
        stalled=stalled(looks, base, finished),
        received=received,
        wasted=wasted,
        retries=fetcher.retries,
        viewed_10=_mean(values[: round(10 / step)]),
        viewed_30=_mean(values[: round(30 / step)]),
        levels=session.extent[0],
        levels_total=session.extent[1],
        level_db=level_db,
        level_db_size=size,
        looks=tuple(looks),
        events=tuple(session.events),
    )


def manifest_quality(session: Session) -> tuple[tuple[float | None, ...], str]:
    """PSNR of each level as the file states it, dB, and the size of the images it is of.

    At the photos' own size where the file has it for every level, else at that of the run.
    """
    for name, note in (("psnr_photo", "photos"), ("psnr_full", "pictures")):
        values = tuple(figures.get(name) for figures in session.quality)
        if values and all(value is not None for value in values):
            return values, session.meta.get(note, "")[:SIZE_LENGTH]
    return (None,) * len(session.quality), ""


def _looks(
    session: Session,
    fetcher: Fetcher,
    flight: Flight,
    show: Show,
    moments: Sequence[float],
    tick: Callable[[float], None] | None,
) -> Iterator[Look]:
    for time in moments:
        while not session.complete and fetcher.transport.now() < time:
            session.advance(time)
        level = -1.0
        if session.base_ready and session.catalog is not None:
            share = covered(session.catalog.low, session.catalog.high, flight.eye(time))
            held = session.levels()
            level = float(share @ held) if share.any() else float(held.mean())
            show.note(session, time)
        if tick is not None:
            tick(time)
        yield Look(time, level, fetcher.received, 0.0)


def stalled(looks: Sequence[Look], base: float, finished: float) -> float:
    """Seconds after the first image in silences of `STALL` or longer."""
    total = silent = 0.0
    for before, now in itertools.pairwise(looks):
        if before.time < base or now.time > finished:
            continue
        silent = silent + now.time - before.time if now.received == before.received else 0.0
        if silent >= STALL:
            total += now.time - before.time if silent > STALL else silent
    return total


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0


def write_timeline(timeline: Timeline, out: Path) -> list[Path]:
    """The timeline as JSON and CSV under a folder; the paths written."""
    paths = [out / "timeline.json", out / "timeline.csv"]
    with published(paths[0]) as draft:
        draft.write_text(json.dumps(asdict(timeline), indent=1) + "\n")
    with published(paths[1]) as draft, draft.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "level", "received_bytes", "psnr_db"])
        for look in timeline.looks:
            writer.writerow(
                [f"{look.time:g}", f"{look.level:.3f}", look.received, f"{look.psnr:.3f}"]
            )
    return paths


class Rendered:
    """Renders the blocks held and the full model, and compares; remembers its renders."""

    def __init__(self, flight: Flight, renderer: Renderer, full: LevelSet | None = None) -> None:
        """One for each file; may serve several plays of it, one after the other.

        Args:
            flight: The camera.
            renderer: Any.
            full: All levels; None takes them from the last session that was noted, which must be
                complete when `psnr` is asked.
        """
        self._flight, self._renderer, self._levels = flight, renderer, full
        self._session: Session | None = None
        self._noted: dict[float, frozenset[Key]] = {}
        self._model: tuple[frozenset[Key], MultiLevelModel] | None = None
        self._truth: dict[int, Image8] = {}
        self._known: dict[tuple[frozenset[Key], int], float] = {}
        self._full: MultiLevelModel | None = None

    def note(self, session: Session, time: float) -> None:
        """See `Show`."""
        self._session = session
        self._noted[time] = frozenset(session.held)

    def psnr(self, time: float) -> float:
        """See `Show`."""
        key, number = self._noted[time], self._flight.number(time)
        if self._is_all(key):
            return FULL_DB
        if (key, number) not in self._known:
            image = self._render(self._model_of(key), self._flight.cameras[number])
            self._known[key, number] = psnr(image, self._true(number))
        return self._known[key, number]

    def compare(self, model: MultiLevelModel, time: float) -> float:
        """PSNR of any model against the full one for the camera at a time, dB."""
        number = self._flight.number(time)
        camera = self._flight.cameras[number]
        return min(FULL_DB, psnr(self._render(model, camera), self._true(number)))

    def forget(self) -> None:
        """Free the model of the past play; figures stay."""
        self._model = None

    def _is_all(self, key: frozenset[Key]) -> bool:
        """Nothing is lacking, so the image is the full model's."""
        assert self._session is not None
        return self._session.catalog is not None and len(key) == len(self._session.catalog.items)

    def _true(self, number: int) -> Image8:
        if number not in self._truth:
            self._truth[number] = self._render(self._whole(), self._flight.cameras[number])
        return self._truth[number]

    def _whole(self) -> MultiLevelModel:
        if self._full is None:
            if self._levels is None:
                assert self._session is not None
                self._levels = self._session.level_set()
            last = len(self._levels.levels) - 1
            region = np.full(self._levels.levels[-1].anchors, last, np.uint8)
            self._full = MultiLevelModel(self._levels, region, self._renderer.device)
        return self._full

    def _model_of(self, key: frozenset[Key]) -> MultiLevelModel:
        """Model of the items held then; equal ones must be asked for one after the other."""
        if self._model is None or self._model[0] != key:
            assert self._session is not None
            part = self._session.model(key)
            self._model = key, MultiLevelModel(part.levels, part.region, self._renderer.device)
        return self._model[1]

    def _render(self, model: MultiLevelModel, camera: Camera) -> Image8:
        with torch.no_grad():
            return LevelRenderer(model, self._renderer).paint(camera, -1)
