"""The first request of a stream: what it brings, and what is asked for behind it."""

import pytest

from gsynopsis.container.index import parse_index
from gsynopsis.container.layout import INDEX_BYTES_MAX
from gsynopsis.errors import FormatError
from gsynopsis.stream.bootstrap import FIRST, Bootstrap
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.trace import steady
from gsynopsis.stream.virtual import Link, VirtualTransport
from tests.stream.scenes import small_file


def opened(data: bytes, length: int) -> tuple[Bootstrap, Fetcher]:
    """A file's beginning once all that it asks for is there."""
    fetcher = Fetcher(VirtualTransport(data, Link(steady(2))), "small", seed=0)
    start = Bootstrap(fetcher, "small", length)
    while not start.open:
        start.ask()
        for done in fetcher.wait(float("inf")):
            start.take(done)
    return start, fetcher


def test_one_request_opens_a_small_file_and_knows_its_levels() -> None:
    data = small_file()
    start, _ = opened(data, len(data))
    assert start.whole and start.data == data and start.late == 0 and start.cut is None
    assert start.levels == len(parse_index(data, "small").levels)
    assert start.assembler is not None and start.stop == len(data)


def test_a_first_request_is_never_shorter_than_an_index_may_be() -> None:
    fetcher = Fetcher(VirtualTransport(small_file(), Link(steady(2))), "small", seed=0)
    start = Bootstrap(fetcher, "small", 1)
    assert start.stop == INDEX_BYTES_MAX and not start.open
    start.ask()
    assert list(fetcher.keys) == [FIRST]


def test_a_prefix_of_a_file_has_the_levels_that_are_whole() -> None:
    data = small_file()
    ends = [level.end for level in parse_index(data, "small").levels]
    start, _ = opened(data[: ends[1]], len(data))
    assert start.levels == 2 and start.cut is None
    torn, _ = opened(data[: ends[1] + 5], len(data))
    assert torn.levels == 2 and torn.cut is not None and "ends within level 2" in str(torn.cut)


def test_bytes_that_are_no_file_are_refused() -> None:
    with pytest.raises(FormatError):
        opened(b"not a file" * 9000, 1 << 16)


def test_directories_behind_the_first_bytes_are_asked_for_by_name() -> None:
    data = small_file(8)  # so many blocks that their directories do not fit before level 0
    start, _ = opened(data, INDEX_BYTES_MAX)
    assert start.late > 0 and start.levels == len(parse_index(data, "small").levels)
