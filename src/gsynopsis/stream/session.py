"""A stream from its first byte to its last: asks, checks, assembles, and says what is ready.

From `base-ready` on the model in hand can be drawn at any moment. Only bytes whose checksums are
right become part of it, so a connection that is lost at any byte never makes a wrong picture.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from gsynopsis.errors import ChecksumError, LayoutError
from gsynopsis.pack import Assembler
from gsynopsis.pack.assembler import Partial
from gsynopsis.pack.layout import INDEX_BYTES_MAX, ChunkEntry, Kind
from gsynopsis.records import Frame, LevelSet
from gsynopsis.stream.catalog import SHARED, Catalog, Item, Key, Part, catalog_of
from gsynopsis.stream.fetch import Fetcher, Got
from gsynopsis.stream.policy import Float64, Policy, State, estimate, levels_now
from gsynopsis.stream.views import Eye, shares_over

AHEAD = tuple(float(second) for second in range(11))
"""Moments ahead at which a policy sees the picture, seconds."""
PIPE = 0.15
"""Seconds of bytes under way below which the next request goes out: three round trips (ours)."""
RUN = 0.1
"""Items side by side in the file are asked for as one if together they take no longer, seconds."""
REPAIRS = 3
"""Times that a part with a wrong checksum is asked for again."""
HEADER = "header"

EventName = Literal["header", "base-ready", "level-ready", "block-ready", "complete"]
Eyes = Callable[[float, Sequence[float]], Sequence[Eye]]
"""Session time and seconds ahead: the cameras expected then; the first is the present one. None
at all where nobody knows."""


def still(time: float, ahead: Sequence[float]) -> Sequence[Eye]:
    """Eyes of whoever does not know the camera: all regions count alike."""
    return ()


@dataclass(frozen=True)
class Event:
    """Something became ready.

    Attributes:
        name: What.
        time: Seconds since the session began.
        received: Bytes that had arrived by then.
        level: Of `level-ready` and `block-ready`, else -1.
        block: Of `block-ready`, else -1.
    """

    name: EventName
    time: float
    received: int
    level: int = -1
    block: int = -1


@dataclass(frozen=True)
class Plan:
    """How a session streams.

    Attributes:
        policy: Chooses the next item.
        eyes: Where the camera is and will be.
        by_blocks: Ask for blocks; False asks for whole levels.
        budget: Gaussian slots that the device can draw; 0: no limit.
    """

    policy: Policy
    eyes: Eyes
    by_blocks: bool = True
    budget: int = 0


class Session:
    """One file, one camera, one policy. Not for several threads.

    Attributes:
        plan: May be replaced at any time, for instance when the header has said where to fly.
        events: All so far, in order.
        catalog: What there is; None before the header.
        held: Items that are complete and checked.
        overhead: Bytes of index, manifest and directories.
    """

    def __init__(self, fetcher: Fetcher, name: str, plan: Plan) -> None:
        """Nothing is asked for before the first `advance`.

        Args:
            fetcher: Where bytes come from; closed by whoever made it.
            name: What messages call the file.
            plan: How to stream.
        """
        self._fetcher, self._name, self.plan = fetcher, name, plan
        self._assembler: Assembler | None = None
        self._pending: dict[Key, list[Part]] = {}
        self._repairs: Counter[Key] = Counter()
        self._early: dict[Key, Got] = {}
        self._damaged: dict[Key, tuple[int, int]] = {}
        self._lent: set[Key] = set()
        self._head = b""
        self._directories: list[ChunkEntry] = []
        self._late: dict[ChunkEntry, bytes] = {}
        self._ready = 0
        self.events: list[Event] = []
        self.catalog: Catalog | None = None
        self.held: set[Key] = set()
        self.overhead = 0

    @property
    def base_ready(self) -> bool:
        """There is something to draw."""
        return self._ready > 0

    @property
    def complete(self) -> bool:
        """All that the device can draw is there."""
        return bool(self.events) and self.events[-1].name == "complete"

    @property
    def meta(self) -> dict[str, str]:
        """Notes of the manifest; empty before the header."""
        return dict(self._assembler.meta) if self._assembler else {}

    def frame(self) -> Frame:
        """The scene's frame.

        Raises:
            LayoutError: before the header.
        """
        if self._assembler is None:
            raise LayoutError(self._name, found="no header yet")
        head = self._assembler.index.header
        center = np.array([head.center_x, head.center_y, head.center_z], np.float64)
        return Frame(head.voxel, center, head.radius, bool(head.contract), head.extent)

    def model(self) -> Partial:
        """What can be drawn now; a copy.

        Raises:
            LayoutError: before `base-ready`.
        """
        if self._assembler is None:
            raise LayoutError(self._name, found="no header yet")
        return self._assembler.partial()

    def level_set(self) -> LevelSet:
        """All complete levels; a copy.

        Raises:
            LayoutError: before `base-ready`.
        """
        if self._assembler is None:
            raise LayoutError(self._name, found="no header yet")
        return self._assembler.level_set()

    def levels(self) -> np.ndarray:
        """Level of each leaf now, [R]; -1 where nothing is."""
        return levels_now(self._state(), asked=False)

    def advance(self, until: float) -> list[Event]:
        """Stream until that time, or until something is ready, or all is complete.

        Args:
            until: Seconds of the session's clock.

        Returns:
            What became ready at once; empty if `until` was reached first.

        Raises:
            SourceError: bytes cannot be had; what is in hand stays good.
            FormatError: the file is damaged, beyond asking again.
        """
        known = len(self.events)
        while not self.complete and self._fetcher.lines.now() < until:
            self._ask()
            for got in self._fetcher.wait(until):
                self._take(got)
            if len(self.events) > known:
                break
        return self.events[known:]

    def _ask(self) -> None:
        """Send requests until enough is under way."""
        if self.catalog is None:
            self._ask_for_header()
            return
        while self._damaged and self._fetcher.free > 0:
            damaged, span = self._damaged.popitem()
            self._fetcher.request((damaged,), *span)
        while self._fetcher.free > 0:
            under_way = sum(self._fetcher.left(key) for key in self._fetcher.keys)
            if under_way > PIPE * estimate(self._fetcher.samples):
                return
            key = self.plan.policy(self._state())
            if key is None:
                return
            run = self._run_from(self.catalog, key)
            for each in run:
                self._pending[each] = list(self.catalog.items[each].parts)
            last = self.catalog.items[run[-1]]
            self._fetcher.request(run, self.catalog.items[key].start, last.stop)

    def _run_from(self, catalog: Catalog, key: Key) -> tuple[Key, ...]:
        """An item, and those right behind it in the file that come in no time along with it.

        On a fast link many small requests would wait for round trips more than for bytes.
        """
        if self.plan.budget or key in self._lent:
            return (key,)
        known = self._state_keys() | self.held | self._lent
        room = RUN * estimate(self._fetcher.samples)
        run, stop = [key], catalog.items[key].stop
        size = catalog.items[key].size
        for other, item in catalog.items.items():
            if item.start == stop and item.size and other != key:
                size += item.size
                if other in known or size > room:
                    break
                run.append(other)
                stop = item.stop
        return tuple(run)

    def _state_keys(self) -> frozenset[Key]:
        """Items that are under way, or here but not yet of use."""
        runs = [
            cast("tuple[Any, ...]", run) for run in self._fetcher.keys if isinstance(run, tuple)
        ]
        asked = [each for run in runs for each in run]
        keys = (*asked, *self._early, *self._damaged)
        return frozenset(key for key in keys if isinstance(key, Key))

    def _ask_for_header(self) -> None:
        """The first bytes; then directories that are not within them."""
        if self._assembler is None:
            if not self._fetcher.keys:
                self._fetcher.request(HEADER, 0, INDEX_BYTES_MAX, clip=True)
            return
        for chunk in self._directories:
            if self._fetcher.free > 0 and chunk not in self._fetcher.keys:
                self._fetcher.request(chunk, chunk.offset, chunk.offset + chunk.stored)

    def _state(self) -> State:
        """What the policy may look at."""
        assert self.catalog is not None
        eyes = self.plan.eyes(self._fetcher.lines.now(), AHEAD)
        return State(
            catalog=self.catalog,
            held=frozenset(self.held),
            asked=self._state_keys(),
            samples=self._fetcher.samples,
            shares=self._shares(eyes),
            moments=np.array(AHEAD),
            budget=self.plan.budget,
        )

    def _shares(self, eyes: Sequence[Eye]) -> Float64:
        assert self.catalog is not None
        if not eyes:
            return np.full((len(AHEAD), self.catalog.leaves), 1.0 / self.catalog.leaves)
        found = shares_over(self.catalog.low, self.catalog.high, eyes)
        # A camera that sees no region still has a picture: all regions count alike.
        found[found.sum(axis=1) == 0] = 1.0 / self.catalog.leaves
        return found

    def _take(self, got: Got) -> None:
        if self.catalog is not None:
            self._split(self.catalog, cast("tuple[Key, ...]", got.key), got)
            self._take_items(self.catalog)
            return
        if self._assembler is None:
            self._assembler, self._head = Assembler(got.data, self._name), got.data
            chunks = self._assembler.index.chunks
            self._directories = [c for c in chunks if c.kind in {Kind.MANIFEST, Kind.DIRECTORY}]
            spans = {c: got.data[c.offset : c.offset + c.stored] for c in self._directories}
        else:
            spans = {c: got.data for c in self._directories if c == got.key}
        self._late |= {c: data for c, data in spans.items() if len(data) == c.stored}
        # A directory is read with that of the level before, so they are taken in their order.
        while self._directories and self._directories[0] in self._late:
            chunk = self._directories.pop(0)
            self._assembler.add(chunk, self._late.pop(chunk))
        if not self._directories:
            self._open(self._assembler, got.ended)

    def _open(self, assembler: Assembler, time: float) -> None:
        """Index and all directories are there."""
        self.catalog = catalog_of(assembler, by_blocks=self.plan.by_blocks)
        base = self.catalog.items[Key(0, SHARED)]
        self.overhead = base.start + sum(
            c.stored
            for c in assembler.index.chunks
            if c.kind == Kind.DIRECTORY and c.offset >= base.start
        )
        for item in self.catalog.items.values():
            if item.start < len(self._head):
                known = self._head[item.start : item.stop]
                self._lent.add(item.key)
                self._fetcher.lend((item.key,), item.start, item.stop, known)
        self._head = b""
        self._tell("header", time)

    def _split(self, catalog: Catalog, run: tuple[Key, ...], got: Got) -> None:
        """The items of a run."""
        start = self._pending[run[0]][0].start
        for key in run:
            first = self._pending[key][0].start
            data = got.data[first - start : catalog.items[key].stop - start]
            self._early[key] = Got(key, data, got.began, got.ended)

    def _take_items(self, catalog: Catalog) -> None:
        """Take what has all that it needs: a small block can be there before its parent."""
        waiting = True
        while waiting:
            waiting = False
            for key in list(self._early):
                if self.held.issuperset(catalog.items[key].needs):
                    self._take_item(catalog.items[key], self._early.pop(key))
                    waiting = True

    def _take_item(self, item: Item, got: Got) -> None:
        """Check and assemble the parts of an item; ask again for what is damaged."""
        assert self._assembler is not None
        parts = self._pending[item.key]
        start = parts[0].start
        while parts:
            part = parts[0]
            stored = got.data[part.start - start : part.stop - start]
            try:
                if part.chunk is None:
                    self._assembler.add_block(part.level, part.block, stored)
                else:
                    self._assembler.add(part.chunk, stored)
            except ChecksumError:
                self._repairs[item.key] += 1
                if self._repairs[item.key] > REPAIRS:
                    raise
                self._damaged[item.key] = (part.start, item.stop)
                return
            parts.pop(0)
        self.held.add(item.key)
        if item.key.block != SHARED:
            self._tell("block-ready", got.ended, item.key.level, item.key.block)
        self._tell_levels(got.ended)

    def _tell_levels(self, time: float) -> None:
        assert self._assembler is not None
        assert self.catalog is not None
        ready = self._assembler.levels_ready
        for level in range(self._ready, ready):
            if level == 0:
                self._tell("base-ready", time)
            self._tell("level-ready", time, level)
        self._ready = ready
        if len(self.held) == len(self.catalog.items):
            self._tell("complete", time)

    def _tell(self, name: EventName, time: float, level: int = -1, block: int = -1) -> None:
        # A block that had to wait for its parent is ready when that is.
        time = max([time, *(event.time for event in self.events[-1:])])
        self.events.append(Event(name, time, self._fetcher.received, level, block))
