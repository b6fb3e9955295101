"""A stream from its first byte to its last: requests, checks, assembles, and reports what is ready.

From `base-ready` on the model in hand can be rendered at any moment. Only bytes whose checksums are
right become part of it, so a connection that is lost at any byte never makes a wrong image.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from gsynopsis.container import Assembler
from gsynopsis.container.assembler import Partial
from gsynopsis.errors import ChecksumError, LayoutError, SourceError
from gsynopsis.records import Frame, LevelSet
from gsynopsis.stream.bootstrap import FIRST_BYTES, Bootstrap
from gsynopsis.stream.catalog import (
    PAGES,
    SHARED,
    Catalog,
    Item,
    Key,
    Part,
    block_parts,
    catalog_of,
)
from gsynopsis.stream.coalesce import coalesce
from gsynopsis.stream.fetch import FetchedRange, Fetcher
from gsynopsis.stream.lookahead import HORIZON
from gsynopsis.stream.policy import SEEN, Float64, Policy, State, estimate, levels_now
from gsynopsis.stream.views import LEAK, ViewPose, covered_by

AHEAD = tuple(float(second) for second in range(int(HORIZON) + 1))
"""Moments ahead at which a policy sees the image, seconds: as far as ours looks."""
PIPE = 0.3
"""Seconds of bytes under way below which the next request goes out: six round trips (ours; reads
that share a link end together, so with fewer it falls idle)."""
BASE_PIPE = 0.1
"""The same before the base is there, seconds: what would share the link with it delays the first
image, but a connection's set-up takes two round trips (ours)."""
REPAIRS = 3
"""Times that a part with a wrong checksum is asked for again."""
BASE = Key(0, SHARED)

EventName = Literal["header", "base-ready", "level-ready", "block-ready", "complete"]
Eyes = Callable[[float, Sequence[float]], Sequence[ViewPose]]
"""Expected cameras, from session time and seconds ahead; the first is the present one.

Empty if the camera is unknown.
"""


def still(time: float, ahead: Sequence[float]) -> Sequence[ViewPose]:
    """Uniform weights: the camera is unknown."""
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
class SessionOptions:
    """Options of a session.

    Attributes:
        policy: Chooses the next item.
        eyes: Camera poses now and ahead.
        by_blocks: Request blocks; False requests whole levels.
        budget: Gaussian slots that the device can render; 0: no limit.
        first: Bytes of the first request.
    """

    policy: Policy
    eyes: Eyes
    by_blocks: bool = True
    budget: int = 0
    first: int = FIRST_BYTES


class Session:
    """One file, one camera, one policy. Not for several threads.

    Attributes:
        options: May be replaced at any time, for instance when the header has said where to fly.
        events: All so far, in order.
        catalog: What there is; None before the header.
        held: Items that are complete and checked.
    """

    def __init__(self, fetcher: Fetcher, name: str, options: SessionOptions) -> None:
        """Prepare a session; nothing is requested before the first `advance`.

        Args:
            fetcher: Source of the bytes; closed by its owner.
            name: Name of the file in messages.
            options: Options.
        """
        self._fetcher, self._name, self.options = fetcher, name, options
        self._opening = Bootstrap(fetcher, name, options.first)
        self._pending: dict[Key, list[Part]] = {}
        self._repairs: Counter[Key] = Counter()
        self._early: dict[Key, FetchedRange] = {}
        self._damaged: dict[Key, tuple[int, int]] = {}
        self._first: list[Key] = []
        self._tails: list[FetchedRange] = []
        self._ready = 0
        self.events: list[Event] = []
        self.catalog: Catalog | None = None
        self.held: set[Key] = set()

    @property
    def _assembler(self) -> Assembler | None:
        return self._opening.assembler

    @property
    def useful(self) -> int:
        """Bytes in hand that need not come again, those of unfinished requests left out."""
        first = len(self._opening.data) if self._opening.whole else 0
        if self.catalog is None:
            return first
        stop = self._opening.stop
        items = [self.catalog.items[key] for key in (*self.held, *self._early)]
        beyond = sum(max(0, item.stop - max(item.start, stop)) for item in items)
        return self._opening.late + first + beyond

    @property
    def base_ready(self) -> bool:
        """There is something to render."""
        return self._ready > 0

    @property
    def complete(self) -> bool:
        """All that the file holds is there."""
        return bool(self.events) and self.events[-1].name == "complete"

    @property
    def extent(self) -> tuple[int, int]:
        """Levels that the file holds, fewer in a prefix, and those that its tables list."""
        return self._opening.levels, len(self._known().index.levels)

    @property
    def meta(self) -> dict[str, str]:
        """Notes of the manifest; empty before the header."""
        return dict(self._assembler.meta) if self._assembler else {}

    @property
    def quality(self) -> list[dict[str, float]]:
        """Figures of the manifest for each level that the file holds; empty before the header."""
        return self._assembler.quality[: self.extent[0]] if self._assembler else []

    def frame(self) -> Frame:
        """The scene's frame.

        Raises:
            LayoutError: before the header.
        """
        head = self._known().index.header
        center = np.array([head.center_x, head.center_y, head.center_z], np.float64)
        return Frame(head.voxel, center, head.radius, bool(head.contract), head.extent)

    def model(self, held: Collection[Key] | None = None) -> Partial:
        """The model that can be rendered now; a copy.

        Args:
            held: Use only these of the held items, the base among them.

        Raises:
            LayoutError: before `base-ready`.
        """
        known = self._known()
        if held is None:
            return known.partial()
        blocks: dict[int, Collection[int]] = {}
        for level, entry in enumerate(known.index.levels[1:], start=1):
            if self.options.by_blocks:
                blocks[level] = [key.block for key in held if key.level == level and key.block >= 0]
            elif Key(level, SHARED) in held:
                blocks[level] = range(entry.blocks)
        return known.partial(blocks)

    def level_set(self) -> LevelSet:
        """All complete levels; a copy.

        Raises:
            LayoutError: before `base-ready`.
        """
        return self._known().level_set()

    def _known(self) -> Assembler:
        if self._assembler is None:
            raise LayoutError(self._name, found="no header yet")
        return self._assembler

    def levels(self) -> np.ndarray:
        """Level of each leaf now, [R]; -1 where nothing is."""
        return levels_now(self._state(), asked=False)

    def advance(self, until: float) -> list[Event]:
        """Stream until that time, or until something is ready, or all is complete.

        Args:
            until: Seconds of the session's clock.

        Returns:
            The events at that time; empty if `until` was reached first, or if nothing more will
            come because a small device has all that it can render.

        Raises:
            SourceError: bytes cannot be had; everything held stays good.
            FormatError: the file is still damaged after another request.
        """
        known = len(self.events)
        while not self.complete and self._fetcher.transport.now() < until:
            self._ask()
            if not self._fetcher.keys and self._at_rest() and until == math.inf:
                break
            for completed in self._fetcher.wait(until):
                self._take(completed)
            self._use_first_bytes()
            if len(self.events) > known:
                break
        return self.events[known:]

    def _at_rest(self) -> bool:
        """Nothing is under way because a small device has all that it can render.

        Raises:
            SourceError: it is not for that; waiting would have no end.
        """
        if self.options.budget and self.base_ready:
            return True
        held, of = len(self.held), len(self.catalog.items) if self.catalog else 0
        found = f"nothing left to ask for with {held} of {of} parts"
        raise SourceError(self._name, found=found, expected="all; the file ends early")

    def _ask(self) -> None:
        """Send requests until enough is under way."""
        if self.catalog is None:
            self._opening.ask()
            return
        while self._damaged and self._fetcher.free > 0:
            damaged, span = self._damaged.popitem()
            self._fetcher.request((damaged,), *span)
        if BASE not in self._state_keys() | self.held:
            self._request(self.catalog, (BASE,))
        while self._fetcher.free > 0:
            under_way = sum(self._fetcher.left(key) for key in self._fetcher.keys)
            pipe = PIPE if self.base_ready else BASE_PIPE
            if under_way > pipe * estimate(self._fetcher.samples):
                return
            state = self._state()
            key = self._choice(state)
            if key is None:
                return
            rate = 0.0 if self.options.budget else estimate(self._fetcher.samples)
            run = coalesce(self.catalog, key, state.known, rate)
            self._request(self.catalog, run)

    def _choice(self, state: State) -> Key | None:
        """The next item to request: a wanted page, one at a time, else the policy's choice.

        A page is small beside its blocks, and the policy then chooses among more of the visible
        blocks. If the policy has no block left, more pages are requested at once.
        """
        page = self._wanted_page(state)
        if page and not any(key.block <= PAGES for key in state.asked):
            return page
        key = self.options.policy(state)
        return page if page and (key is None or key.block <= PAGES) else key

    def _wanted_page(self, state: State) -> Key | None:
        """The missing page that the images ahead show most, of those that divide a held block."""
        if not (self.base_ready and state.catalog.awaits):
            return None
        best, most = None, SEEN
        # What is shared out among all regions tells nothing of one of them.
        shares = state.shares - LEAK / state.catalog.leaves
        for key, leaves in state.catalog.awaits.items():
            share = float(shares[:, leaves].sum(axis=1).max())
            if share > most and key not in state.known and self._reaches(key):
                best, most = key, share
        return best

    def _reaches(self, key: Key) -> bool:
        """True if a block that a page's blocks divide is held."""
        divided = self._known().pages[key.level].parents_of(PAGES - key.block)
        return key.level == 1 or any(Key(key.level - 1, block) in self.held for block in divided)

    def _request(self, catalog: Catalog, run: tuple[Key, ...]) -> None:
        """Ask for items side by side; what of them the first request brings is left out."""
        for each in run:
            self._pending[each] = list(catalog.items[each].parts)
        start, stop = catalog.items[run[0]].start, catalog.items[run[-1]].stop
        self._fetcher.request(run, min(stop, max(start, self._opening.stop)), stop)

    def _state_keys(self) -> frozenset[Key]:
        """Items that are under way, or here but not yet of use."""
        runs = [
            cast("tuple[Any, ...]", run) for run in self._fetcher.keys if isinstance(run, tuple)
        ]
        asked = [each for run in runs for each in run]
        waiting = [
            each for completed in self._tails for each in cast("tuple[Any, ...]", completed.key)
        ]
        keys = (*asked, *waiting, *self._first, *self._early, *self._damaged)
        return frozenset(key for key in keys if isinstance(key, Key))

    def _state(self) -> State:
        """The state for the policy."""
        assert self.catalog is not None
        eyes = self.options.eyes(self._fetcher.transport.now(), AHEAD)
        return State(
            catalog=self.catalog,
            held=frozenset(self.held),
            asked=self._state_keys(),
            samples=self._fetcher.samples,
            shares=self._shares(eyes),
            moments=np.array(AHEAD),
            budget=self.options.budget,
        )

    def _shares(self, eyes: Sequence[ViewPose]) -> Float64:
        assert self.catalog is not None
        if not eyes:
            return np.full((len(AHEAD), self.catalog.leaves), 1.0 / self.catalog.leaves)
        found = np.stack([covered_by(self.catalog.parts, eye) for eye in eyes])
        # A camera that sees no region still has an image: all regions count alike.
        found[found.sum(axis=1) == 0] = 1.0 / self.catalog.leaves
        return found

    def _take(self, completed: FetchedRange) -> None:
        if self._opening.take(completed):
            return
        assert self.catalog is not None
        self._tails.append(completed)
        self._take_tails(self.catalog)

    def _use_first_bytes(self) -> None:
        """Take the bytes of the first request so far; the session opens with them."""
        self._opening.look()
        if self.catalog is None and self._opening.open:
            self._open()
        if self.catalog is None or not (self._first or self._tails):
            return
        data, time = self._opening.data, self._opening.time
        for key in [k for k in self._first if self.catalog.items[k].stop <= len(data)]:
            item = self.catalog.items[key]
            self._first.remove(key)
            self._early[key] = FetchedRange(key, data[item.start : item.stop], time)
        self._take_tails(self.catalog)

    def _open(self) -> None:
        """Index and all directories, or page tables, are there."""
        self._list()
        assert self.catalog is not None
        stop = self._opening.stop
        for item in self.catalog.items.values():
            # A small device takes of the rest only what its policy chooses.
            if item.stop <= stop and (item.key == BASE or not self.options.budget):
                self._first.append(item.key)
                self._pending[item.key] = list(item.parts)
        self._emit("header", self._opening.time)

    def _list(self) -> None:
        """List the items, as far as directories and pages are known."""
        levels, by_blocks = self._opening.levels, self.options.by_blocks
        self.catalog = catalog_of(self._known(), levels=levels, by_blocks=by_blocks)

    def _take_tails(self, catalog: Catalog) -> None:
        """Ranges that came, cut into items; one that began in the first bytes waits for those."""
        for completed in list(self._tails):
            run = cast("tuple[Key, ...]", completed.key)
            start = self._pending[run[0]][0].start
            lacks = catalog.items[run[-1]].stop - start - len(completed.data)
            if lacks and not self._opening.whole:
                continue
            self._tails.remove(completed)
            data = self._opening.data[start : start + lacks] + completed.data
            ended = max(completed.ended, self._opening.time) if lacks else completed.ended
            for key in run:
                item, first = catalog.items[key], self._pending[key][0].start
                part = data[first - start : item.stop - start]
                self._early[key] = FetchedRange(key, part, ended)
        self._take_items(catalog)

    def _take_items(self, catalog: Catalog) -> None:
        """Take what has all that it needs: a small block can be there before its parent."""
        waiting = True
        while waiting:
            waiting = False
            for key in list(self._early):
                if self.held.issuperset(catalog.items[key].needs):
                    self._take_item(catalog.items[key], self._early.pop(key))
                    waiting = True

    def _take_item(self, item: Item, completed: FetchedRange) -> None:
        """Check and assemble the parts of an item; request damaged ones again."""
        assert self._assembler is not None
        parts = self._pending[item.key]
        start = parts[0].start
        while parts:
            part = parts[0]
            stored = completed.data[part.start - start : part.stop - start]
            try:
                if part.block <= PAGES:
                    page = PAGES - part.block
                    self._assembler.add_page(part.level, page, stored)
                    if item.key.block == SHARED:
                        blocks = self._assembler.pages[part.level].blocks_of(page)
                        parts[1:1] = block_parts(self._assembler, part.level, blocks)
                elif part.chunk is None:
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
        if self._assembler.index.paged and (item.key == BASE or item.key.block <= PAGES):
            self._list()
        self.held.add(item.key)
        if item.key.block >= 0:
            self._emit("block-ready", completed.ended, item.key.level, item.key.block)
        self._emit_levels(completed.ended)

    def _emit_levels(self, time: float) -> None:
        assert self._assembler is not None
        assert self.catalog is not None
        ready = self._assembler.levels_ready
        for level in range(self._ready, ready):
            if level == 0:
                self._emit("base-ready", time)
            self._emit("level-ready", time, level)
        self._ready = ready
        if len(self.held) == len(self.catalog.items):
            if self._opening.cut:
                raise self._opening.cut
            self._emit("complete", time)

    def _emit(self, name: EventName, time: float, level: int = -1, block: int = -1) -> None:
        # A block that had to wait for its parent is ready when that is.
        time = max([time, *(event.time for event in self.events[-1:])])
        self.events.append(Event(name, time, self._fetcher.received, level, block))
