"""A session over a file whose directories are in pages asks for the pages that it needs."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.container import decode
from gsynopsis.container.assembler import Assembler
from gsynopsis.container.index import parse_index
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import ChecksumError
from gsynopsis.records import LevelSet
from gsynopsis.stream.catalog import PAGES, SHARED, Catalog, Key, catalog_of
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.paged import UNKNOWN, leaves_of
from gsynopsis.stream.policy import SEEN
from gsynopsis.stream.session import Eyes, Session, SessionOptions, still
from gsynopsis.stream.trace import steady
from gsynopsis.stream.views import LEAK, ViewPose, covered
from gsynopsis.stream.virtual import Link, VirtualTransport, random_cuts
from tests.level_sets import SPLATS, Shape, assert_same, make_level_set

SHAPE = Shape(anchors=(300, 500, 900), slots=3, grids=(1, 1, 2))
ANCHORS = make_level_set(np.random.default_rng(8), SHAPE)
PLAIN = make_level_set(np.random.default_rng(9), replace(SPLATS, anchors=(100, 230, 450)))
FIRST = 16384


def paged(levels: LevelSet) -> bytes:
    return encode_with_account(levels, block=8, page=6)[0]


DATA = paged(ANCHORS)
LARGE = paged(make_level_set(np.random.default_rng(8), replace(SHAPE, anchors=(600, 1000, 1700))))
"""Its pages are not all in the first request, and most lie out of sight."""


def session_over(
    transport: VirtualTransport, eyes: Eyes = still, *, by_blocks: bool = True, budget: int = 0
) -> tuple[Session, Fetcher]:
    fetcher = Fetcher(transport, "paged", seed=0)
    return Session(fetcher, "paged", SessionOptions(ours, eyes, by_blocks, budget, FIRST)), fetcher


def run(session: Session) -> None:
    while not session.complete:
        session.advance(math.inf)


def whole(data: bytes) -> Assembler:
    assembler = Assembler(data, "x")
    for _ in assembler.index.levels:
        assembler.add_level(data)
    return assembler


@pytest.mark.parametrize("levels", [ANCHORS, PLAIN], ids=["anchors", "splats"])
@pytest.mark.parametrize("by_blocks", [True, False])
def test_all_comes_once_and_is_the_file(levels: LevelSet, by_blocks: bool) -> None:
    data = paged(levels)
    session, fetcher = session_over(VirtualTransport(data, Link(steady(5))), by_blocks=by_blocks)
    run(session)
    assert fetcher.received == session.useful == len(data)
    assert_same(session.level_set(), decode(data, "x"))


def test_connections_that_break_change_nothing() -> None:
    link = Link(steady(2), cuts=random_cuts(len(DATA), 9, seed=1))
    session, _ = session_over(VirtualTransport(DATA, link))
    run(session)
    assert_same(session.level_set(), decode(DATA, "x"))


def test_a_prefix_is_its_levels() -> None:
    data = DATA[: parse_index(DATA, "x").levels[1].end]
    session, _ = session_over(VirtualTransport(data, Link(steady(5))))
    run(session)
    assert session.extent == (2, 3)
    assert_same(session.level_set(), decode(data, "x"))


class Wrong(VirtualTransport):
    """Changes a byte at a place, so many times."""

    def __init__(self, data: bytes, at: int, times: int) -> None:
        changed = data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]
        super().__init__(changed, Link(steady(5)))
        self._right, self._at, self._times = memoryview(data), at, times

    def begin(self, start: int, stop: int) -> int:
        if start <= self._at < stop:
            self._times -= 1
            if self._times < 0:
                self._data = self._right
        return super().begin(start, stop)


def page_of(data: bytes, level: int) -> int:
    """Where a page of a level lies that the first request does not bring."""
    found = whole(data).pages[level].offsets
    return int(found[found > FIRST][-1])


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_damaged_page_is_asked_for_again(level: int) -> None:
    data = DATA if level else LARGE
    at = page_of(data, level) + 7
    session, _ = session_over(Wrong(data, at, 1))
    run(session)
    assert_same(session.level_set(), decode(data, "x"))
    session, _ = session_over(Wrong(data, at, 99))
    with pytest.raises(ChecksumError, match=f"level {level} page"):
        run(session)


def looking(session_time: float, ahead: Sequence[float]) -> Sequence[ViewPose]:
    """From above one corner of the scene: a part of it is seen."""
    w2c = np.eye(4)
    w2c[:3, 3] = [-0.6, -0.6, -0.2]
    return [ViewPose(w2c, 0.2, 0.2)] * len(ahead)


def seen_by(catalog: Catalog) -> set[Key]:
    """Pages that the camera waits for."""
    shares = covered(catalog.low, catalog.high, looking(0, [0])[0])
    shares -= LEAK / catalog.leaves
    return {key for key, leaves in catalog.awaits.items() if shares[leaves].sum() > SEEN}


def test_pages_come_where_the_camera_looks() -> None:
    session, _ = session_over(VirtualTransport(LARGE, Link(steady(0.5))), looking)
    while not session.base_ready:
        session.advance(math.inf)
    assert session.catalog is not None
    seen, lacking = seen_by(session.catalog), set(session.catalog.awaits)
    pages = {key for key in session.held if key.block <= PAGES}
    assert 0 < len(seen) < len(lacking) / 2
    order: list[Key] = []
    while not {key for key in session.held if key.level == 1} >= seen:
        session.advance(math.inf)
        order += [k for k in session.held if k.block <= PAGES and k not in pages | set(order)]
    # Others come only as neighbours of what is asked for.
    assert len({key for key in order if key.level == 1} - seen) < len(lacking - seen) / 8
    assert any(key.level == 1 and key.block >= 0 for key in session.held)
    run(session)
    assert_same(session.level_set(), decode(LARGE, "x"))


def test_what_is_known_at_last_is_what_a_whole_directory_says() -> None:
    paged_catalog = catalog_of(whole(DATA))
    flat = whole(encode_with_account(ANCHORS, block=8)[0])
    catalog = catalog_of(flat)
    blocks = [key for key in paged_catalog.items if key.block > PAGES]
    assert blocks == list(catalog.items) and not paged_catalog.awaits
    assert (paged_catalog.low == catalog.low).all() and (paged_catalog.high == catalog.high).all()
    for key in blocks:
        ours_, theirs = paged_catalog.items[key], catalog.items[key]
        assert ours_.needs == theirs.needs and ours_.slots == theirs.slots, key
        assert ours_.size == theirs.size or key == Key(0, SHARED)
        assert (ours_.region == theirs.region).all()
    spans = sorted((item.start, item.stop) for item in paged_catalog.items.values() if item.size)
    assert all(a[1] <= b[0] for a, b in itertools.pairwise(spans))


def test_leaves_are_what_is_known() -> None:
    client, full = Assembler(DATA, "x"), whole(DATA)
    for chunk in client.index.chunks[:4]:
        client.add(chunk, DATA[chunk.offset : chunk.offset + chunk.stored])
    assert len(leaves_of(client, 3).low) == len(client.pages[0])
    for page in range(len(client.pages[0])):
        client.add_page(0, page, DATA[slice(*client.pages[0].span_of(page))])
    assert len(leaves_of(client, 3).low) == client.index.levels[0].blocks
    client.add_page(1, 1, DATA[slice(*client.pages[1].span_of(1))])
    leaves = leaves_of(client, 3)
    blocks = client.pages[1].blocks_of(1)
    assert sorted(leaves.lineage[1][leaves.lineage[1] != UNKNOWN]) == list(blocks)
    parents = set(full.directories[1].records["parent"][list(blocks)].tolist())
    assert set(leaves.lineage[0][leaves.lineage[1] != UNKNOWN].tolist()) == parents
    assert set(leaves.lineage[0].tolist()) == set(range(client.index.levels[0].blocks))
    assert (leaves.lineage[2] == UNKNOWN).all()


def test_a_small_device_has_what_it_can_render() -> None:
    slots = parse_index(DATA, "x").levels[1].live
    session, fetcher = session_over(VirtualTransport(DATA, Link(steady(5))), looking, budget=slots)
    while fetcher.transport.now() < 9.0:
        session.advance(9.0)
    assert session.model().levels.levels[-1].live <= slots
    assert any(key.level > 0 and key.block >= 0 for key in session.held)
