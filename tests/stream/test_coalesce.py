from gsynopsis.stream.catalog import SHARED, Key
from gsynopsis.stream.coalesce import coalesce
from tests.stream.scenes import hand_made

CATALOG = hand_made({(1, leaf): 1000 for leaf in range(6)}, (1e-2, 1e-5), 6, (500, 100))
BLOCKS = [Key(1, leaf) for leaf in range(6)]
HELD = {Key(0, SHARED), Key(1, SHARED)}


def test_those_behind_come_along_as_far_as_they_come_in_a_twentieth_of_a_second() -> None:
    # All sixty take longer than half a second: it is not the end.
    wide = hand_made({(1, leaf): 1000 for leaf in range(60)}, (1e-2, 1e-5), 60, (500, 100))
    names = [Key(1, leaf) for leaf in range(60)]
    for rate, count in ((39_999, 1), (40_000, 2), (60_000, 3), (119_000, 5)):
        assert coalesce(wide, names[7], HELD, rate) == tuple(names[7 : 7 + count])


def test_in_the_end_requests_are_twice_as_long_and_leave_no_gaps() -> None:
    assert coalesce(CATALOG, BLOCKS[3], HELD, 20_000) == tuple(BLOCKS[3:5])
    assert coalesce(CATALOG, BLOCKS[5], HELD, 40_000) == tuple(BLOCKS[2:])
    assert coalesce(CATALOG, BLOCKS[3], HELD, 1e6) == tuple(BLOCKS)


def test_what_is_known_is_not_asked_for_again() -> None:
    known = {*HELD, BLOCKS[1], BLOCKS[4]}
    assert coalesce(CATALOG, BLOCKS[3], known, 1e6) == tuple(BLOCKS[2:4])


def test_without_a_rate_an_item_comes_alone() -> None:
    assert coalesce(CATALOG, BLOCKS[3], HELD, 0.0) == (BLOCKS[3],)


def test_an_item_without_bytes_breaks_no_run() -> None:
    sizes = {(1, leaf): 1000 for leaf in range(3)}
    catalog = hand_made(sizes, (1e-2, 1e-5), 3, (500, 0))
    whole = tuple(Key(1, leaf) for leaf in range(3))
    assert coalesce(catalog, Key(1, 0), {Key(0, SHARED)}, 1e6) == whole
