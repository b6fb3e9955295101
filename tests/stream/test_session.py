"""Sessions over the virtual clock: whatever the network does, the model in hand is right."""

import hashlib
import random
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsynopsis.container import decode, encode
from gsynopsis.container.assembler import Partial
from gsynopsis.container.index import parse_index
from gsynopsis.errors import ChecksumError, LayoutError, SourceError, TruncatedError
from gsynopsis.records import LevelSet
from gsynopsis.stream import policy
from gsynopsis.stream.bootstrap import FIRST_BYTES
from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.session import Session, SessionOptions, still
from gsynopsis.stream.trace import steady
from gsynopsis.stream.transport import ReceivedBytes, TransportEvent
from gsynopsis.stream.virtual import QUANTUM, Link, VirtualTransport, random_cuts
from tests.level_sets import Shape, assert_same, make_level_set
from tests.stream.scenes import FREE, PLAIN, SHAPE, small_file

POLICIES = [policy.fixed, policy.throughput, policy.bola, policy.mpc, ours]
FOREVER = float("inf")
FIRST = 20_000
"""Bytes of the first request; the usual one would bring nearly all of so small a file."""
VECTORS = Path(__file__).parents[1] / "container" / "vectors"
LARGE_BASE = Shape(anchors=(4000, 5000), slots=4, grids=(1, 2))


def session_over(
    transport: VirtualTransport,
    rule: policy.Policy = ours,
    *,
    by_blocks: bool = True,
    budget: int = 0,
) -> tuple[Session, Fetcher]:
    fetcher = Fetcher(transport, "small", seed=0)
    return Session(fetcher, "small", SessionOptions(rule, still, by_blocks, budget, FIRST)), fetcher


def digest(levels: LevelSet) -> str:
    found = hashlib.sha256()
    shared = levels.shared
    arrays = [shared.lattice, shared.log_scales, shared.offsets, shared.codes, shared.residual]
    arrays += [*shared.grids, *(level.mask for level in levels.levels)]
    arrays += [weight for level in levels.levels for weight in level.networks.values()]
    arrays += [level.codebook for level in levels.levels]
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


@pytest.mark.parametrize("shape", [SHAPE, FREE, PLAIN], ids=["own networks", "inherited", "splats"])
@pytest.mark.parametrize("by_blocks", [True, False])
@pytest.mark.parametrize("rule", POLICIES)
def test_a_whole_stream_is_the_file_and_every_byte_came_once(
    rule: policy.Policy, by_blocks: bool, shape: Shape
) -> None:
    data = small_file(shape=shape)
    session, fetcher = session_over(
        VirtualTransport(data, Link(steady(2))), rule, by_blocks=by_blocks
    )
    while not session.complete:
        session.advance(FOREVER)
    assert_same(session.level_set(), decode(data, "small"))
    assert fetcher.received == len(data)
    names = [e.name for e in session.events]
    assert names[0] == "header"
    assert names[-1] == "complete"
    assert names.index("base-ready") < names.index("level-ready")
    assert [e.level for e in session.events if e.name == "level-ready"] == [0, 1, 2, 3]
    shared = sum(key.block == SHARED for key in session.held)
    assert names.count("block-ready") == (len(session.held) - shared if by_blocks else 0)
    assert shared == (1 if shape is PLAIN and by_blocks else 4)
    times = [e.time for e in session.events]
    assert times == sorted(times)


@pytest.mark.parametrize("by_blocks", [True, False])
def test_what_could_be_rendered_before_can_be_had_again(by_blocks: bool) -> None:
    data = small_file()
    session, _ = session_over(VirtualTransport(data, Link(steady(0.1))), by_blocks=by_blocks)
    past: list[tuple[frozenset[Key], Partial]] = []
    while not session.complete:
        session.advance(FOREVER)
        if session.base_ready:
            past.append((frozenset(session.held), session.model()))
    assert len(past) > 3
    for held, expected in past:
        again = session.model(held)
        assert (again.region == expected.region).all()
        assert_same(again.levels, expected.levels)


def test_at_every_moment_after_the_base_the_model_is_a_part_of_the_file() -> None:
    data = small_file()
    whole = decode(data, "small")
    rows = {tuple(cell): n for n, cell in enumerate(whole.shared.lattice.tolist())}
    session, _ = session_over(VirtualTransport(data, Link(steady(0.1))))
    moments = 0
    while not session.complete:
        session.advance(FOREVER)
        if not session.base_ready:
            with pytest.raises(LayoutError):
                session.model()
            continue
        moments += 1
        part = session.model()
        index = np.array([rows[tuple(cell)] for cell in part.levels.shared.lattice.tolist()])
        mask = part.levels.levels[-1].mask
        for level in range(4):
            here = np.flatnonzero(part.region == level)
            full = whole.levels[level].mask[index[here]]
            assert (mask[here] == full).all()
        offsets = np.where(mask[:, :, None], whole.shared.offsets[index], 0)
        assert (part.levels.shared.offsets == offsets).all()
        assert (part.levels.shared.log_scales == whole.shared.log_scales[index]).all()
    assert moments >= 20


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 200), st.sampled_from(POLICIES))
def test_disconnects_never_change_the_model_nor_repeat_bytes(
    seed: int, count: int, rule: policy.Policy
) -> None:
    data = small_file()
    link = Link(steady(5), cuts=random_cuts(len(data), count, seed))
    session, fetcher = session_over(VirtualTransport(data, link), rule)
    while not session.complete:
        session.advance(FOREVER)
    assert digest(session.level_set()) == digest(decode(data, "small"))
    assert fetcher.retries >= count // 2
    assert fetcher.received <= 1.01 * len(data)


class Listed(VirtualTransport):
    """A link that notes which ranges are asked for."""

    def __init__(self, data: bytes, link: Link) -> None:
        super().__init__(data, link)
        self.ranges: list[tuple[int, int]] = []

    def begin(self, start: int, stop: int) -> int:
        self.ranges.append((start, stop))
        return super().begin(start, stop)


def backwards(state: policy.State) -> Key | None:
    """The last blocks of the file first: whatever it asks for leaves a gap before it."""
    return policy.first_of(state, reversed(list(state.catalog.items)))


@pytest.mark.parametrize(("speed", "least", "most"), [(100.0, 3, 6), (0.2, 1, 400)])
def test_an_order_that_jumps_is_few_requests_on_a_fast_line_and_many_on_a_slow_one(
    speed: float, least: int, most: int
) -> None:
    data = small_file()
    transport = Listed(data, Link(steady(speed)))
    session, fetcher = session_over(transport, backwards)
    while not session.complete:
        session.advance(FOREVER)
    assert_same(session.level_set(), decode(data, "small"))
    assert fetcher.received == len(data)
    assert least <= len(transport.ranges) <= most


class Tampered(VirtualTransport):
    """A link on which some pieces of the file arrive wrong, a given number of times."""

    def __init__(self, data: bytes, link: Link, at: int, times: int) -> None:
        super().__init__(data, link)
        self.at, self.times, self.spans = at, times, dict[int, int]()

    def begin(self, start: int, stop: int) -> int:
        ticket = super().begin(start, stop)
        self.spans[ticket] = start
        return ticket

    def wait(self, until: float) -> Sequence[TransportEvent]:
        return [self.changed(item) for item in super().wait(until)]

    def changed(self, item: TransportEvent) -> TransportEvent:
        if not isinstance(item, ReceivedBytes):
            return item
        start = self.spans[item.ticket]
        self.spans[item.ticket] += len(item.data)
        if self.times and start <= self.at < start + len(item.data):
            self.times -= 1
            data = bytearray(item.data)
            data[self.at - start] ^= 0x40
            return ReceivedBytes(item.ticket, bytes(data), item.time)
        return item


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.99])
def test_a_byte_that_arrives_wrong_is_asked_for_again(share: float) -> None:
    data = small_file()
    transport = Tampered(data, Link(steady(5)), int(len(data) * share), times=2)
    session, fetcher = session_over(transport)
    while not session.complete:
        session.advance(FOREVER)
    assert_same(session.level_set(), decode(data, "small"))
    assert transport.times == 0
    assert fetcher.received > len(data)


def test_a_file_that_is_damaged_at_its_source_is_an_error_and_the_model_stays() -> None:
    data = bytearray(small_file())
    data[int(len(data) * 0.8)] ^= 1
    session, _ = session_over(VirtualTransport(bytes(data), Link(steady(5))), policy.fixed)
    with pytest.raises(ChecksumError):
        while not session.complete:
            session.advance(FOREVER)
    assert session.base_ready
    assert len(session.model().levels.shared.lattice) > 0


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("first", [FIRST, FIRST_BYTES, 1 << 22])
@pytest.mark.parametrize(("block", "by_blocks"), [(128, True), (128, False), (8, True)])
def test_a_prefix_streams_to_its_end(level: int, first: int, block: int, by_blocks: bool) -> None:
    data = small_file(block)
    data = data[: parse_index(data, "small").levels[level].end]
    # Directories of blocks of 8 anchors stand each before its level, behind the end of a prefix.
    for rule in (ours, policy.fixed) if block > 8 else (policy.fixed,):
        transport = Listed(data, Link(steady(5)))
        fetcher = Fetcher(transport, "small", seed=0)
        session = Session(fetcher, "small", SessionOptions(rule, still, by_blocks, first=first))
        while not session.complete:
            assert session.advance(FOREVER)
        assert_same(session.level_set(), decode(data, "small"))
        assert session.extent == (level + 1, 4)
        assert fetcher.received == session.useful == len(data)
        assert max(stop for _, stop in transport.ranges[1:] or [(0, 0)]) <= len(data)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(
    "name", ["small-compact", "small-fine", "free-compact", "empty-first", "splats-compact"]
)
def test_a_prefix_of_a_test_vector_streams_to_its_end(level: int, name: str) -> None:
    data = (VECTORS / f"{name}.gsyn").read_bytes()
    data = data[: parse_index(data, "vector").levels[level].end]
    session = Session(
        Fetcher(VirtualTransport(data, Link(steady(5))), "v"), "v", SessionOptions(ours, still)
    )
    while not session.complete:
        assert session.advance(FOREVER)
    assert_same(session.level_set(), decode(data, "vector"))


@pytest.mark.parametrize("first", [FIRST, 1 << 22])
def test_a_file_cut_anywhere_shows_its_whole_levels_and_is_an_error(first: int) -> None:
    data = small_file()
    ends = [level.end for level in parse_index(data, "small").levels]
    for length in (17, 300, ends[0] - 1, ends[0] + 1, ends[1] - 1, ends[2] + 9, ends[3] - 1):
        fetcher = Fetcher(VirtualTransport(data[:length], Link(steady(5))), "small", seed=0)
        session = Session(fetcher, "small", SessionOptions(ours, still, first=first))
        with pytest.raises((SourceError, TruncatedError), match="small") as caught:
            while True:
                assert session.advance(FOREVER)
        held = sum(end <= length for end in ends)
        assert session.base_ready == (held > 0)
        if held:
            assert f"ends within level {held}" in str(caught.value)
            assert len(session.level_set().levels) == held


def test_bytes_behind_the_last_level_are_refused() -> None:
    data = small_file() + b"x"
    session, _ = session_over(VirtualTransport(data, Link(steady(5))))
    with pytest.raises(TruncatedError, match="length"):
        session.advance(FOREVER)


class Hiding(VirtualTransport):
    """A host that does not say how long the file is."""

    size = None  # type: ignore[assignment]


def test_a_prefix_whose_length_nobody_says_streams_too_if_it_is_short() -> None:
    data = small_file()
    data = data[: parse_index(data, "small").levels[1].end]
    session = Session(Fetcher(Hiding(data, Link(steady(5))), "x"), "x", SessionOptions(ours, still))
    while not session.complete:
        assert session.advance(FOREVER)
    assert_same(session.level_set(), decode(data, "small"))


def test_a_session_that_can_get_no_further_says_so() -> None:
    def idle(state: policy.State) -> Key | None:
        return None

    session, _ = session_over(VirtualTransport(small_file(), Link(steady(5))), idle)
    with pytest.raises(SourceError, match="nothing left to ask for"):
        while not session.complete:
            session.advance(FOREVER)


def test_a_file_that_ends_early_is_an_error_and_the_model_stays() -> None:
    data = small_file()[: int(len(small_file()) * 0.7)]
    session, _ = session_over(VirtualTransport(data, Link(steady(5))), policy.fixed)
    with pytest.raises(SourceError):
        while not session.complete:
            session.advance(FOREVER)
    assert session.base_ready


def test_nothing_happens_before_its_time() -> None:
    session, _ = session_over(VirtualTransport(small_file(), Link(steady(5), round_trip=1.0)))
    assert session.advance(1.9) == []
    assert [e.name for e in session.advance(9.0)] == ["header"]


@pytest.mark.parametrize(("block", "rule"), [(128, ours), (8, policy.fixed)])
def test_header_and_base_come_in_one_request(block: int, rule: policy.Policy) -> None:
    # Blocks of 8 anchors have directories that do not fit before level 0; they are so many that
    # to weigh them all for each request takes seconds.
    data = small_file(block)
    index = parse_index(data, "small")
    assert bool(index.header.front) == (block > 8)
    transport = VirtualTransport(data, Link(steady(1), round_trip=1.0))
    session, fetcher = session_over(transport, rule)
    while not session.base_ready:
        session.advance(FOREVER)
    base = next(event for event in session.events if event.name == "base-ready")
    if index.header.front:
        assert base.time <= 2.0 + (index.levels[0].end + QUANTUM) * 8 / 1e6
    while not session.complete:
        session.advance(FOREVER)
    assert fetcher.received == session.useful == len(data)
    assert_same(session.level_set(), decode(data, "small"))


def test_a_base_longer_than_the_first_request_is_asked_for_before_that_ends() -> None:
    data = encode(make_level_set(np.random.default_rng(3), LARGE_BASE))
    end = parse_index(data, "large").levels[0].end
    assert end > 2 * FIRST
    session, fetcher = session_over(VirtualTransport(data, Link(steady(0.5), round_trip=0.1)))
    while not session.complete:
        session.advance(FOREVER)
    base = next(event for event in session.events if event.name == "base-ready")
    # One set-up and one round trip; those of the second request lie behind the first one's bytes.
    assert base.time <= 0.2 + (end + 2 * QUANTUM) * 8 / 0.5e6
    assert fetcher.received == len(data)
    assert_same(session.level_set(), decode(data, "large"))


def test_a_small_device_gets_what_it_can_draw_and_no_more() -> None:
    data = small_file()
    slots = sum(level.live for level in decode(data, "small").levels[1:2])
    session, fetcher = session_over(VirtualTransport(data, Link(steady(5))), budget=slots)
    while fetcher.transport.now() < 5.0:
        session.advance(5.0)
    assert session.base_ready
    assert session.model().levels.levels[-1].live <= slots
    assert session.advance(FOREVER) == []
    assert not session.complete


def test_chance_is_not_needed() -> None:
    first, second = (
        session_over(VirtualTransport(small_file(), Link(steady(3), cuts=(40_000,))))[0]
        for _ in range(2)
    )
    random.seed(1)
    for session in (first, second):
        while not session.complete:
            session.advance(FOREVER)
    assert first.events == second.events
