import errno
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.robust.forge import index_of
from gsynopsis.container import SizeAccount, decode, encode, read_gsyn, write_gsyn
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import InputError, LayoutError, SettingError, SpaceError, ValueRangeError
from gsynopsis.records import LevelSet
from tests.level_sets import ALL_SHAPES, BOTH, EMPTY, Shape, assert_same, make_level_set


@pytest.fixture
def levels(rng: np.random.Generator) -> LevelSet:
    return make_level_set(rng, BOTH)


@pytest.mark.parametrize("coding", ["raw", "compact"])
@pytest.mark.parametrize("name", ALL_SHAPES)
def test_the_account_sums_to_the_length_of_the_file(
    name: str, coding: str, rng: np.random.Generator, tmp_path: Path
) -> None:
    path = tmp_path / "scene.gsyn"
    account = write_gsyn(make_level_set(rng, ALL_SHAPES[name]), path, coding)
    data = path.read_bytes()
    index = index_of(data)
    assert account.total == len(data)
    assert account.index == index.length
    total = 0
    for k, level in enumerate(index.levels):
        total += account.delta(k)
        assert total == level.end
    for k in range(len(index.levels)):
        own = sum(part.stored for part in account.parts if part.level == k)
        assert own + (0 if k else account.index) == account.delta(k)
    assert os.listdir(tmp_path) == ["scene.gsyn"]


def given_and_read(given: LevelSet, read: LevelSet) -> dict[str, list[tuple[np.ndarray, ...]]]:
    """Pairs of arrays by kind of chunk."""
    kept = given.upto(len(given.levels) - 1)
    one, two = kept.shared, read.shared
    pairs = zip(kept.levels, read.levels, strict=True)
    both = [(a, b) for a, b in pairs]
    return {
        "log_scales": [(one.log_scales, two.log_scales)],
        "offsets": [(one.offsets, two.offsets)],
        "residual": [(one.residual, two.residual)],
        "grid": list(zip(one.grids, two.grids, strict=True)),
        "codebook": [(a.codebook, b.codebook) for a, b in both],
        "networks": [(a.networks[n], b.networks[n]) for a, b in both for n in a.networks],
    }


def test_compact_differs_by_what_the_account_says_and_no_more(
    levels: LevelSet, tmp_path: Path
) -> None:
    account = write_gsyn(levels, tmp_path / "a.gsyn")
    read = read_gsyn(tmp_path / "a.gsyn")
    for kind, pairs in given_and_read(levels, read).items():
        worst = max(np.abs(a.astype(np.float64) - b).max(initial=0) for a, b in pairs)
        assert worst == account.error(kind) > 0, kind
    for kind in ("lattice", "codes", "mask", "manifest"):
        assert account.error(kind) == 0
    assert (read.shared.lattice == levels.shared.lattice).all()
    assert (read.shared.codes == levels.shared.codes).all()
    assert all((a.gain == b.gain).all() for a, b in zip(read.levels, levels.levels, strict=True))


def test_a_distant_value_costs_its_own_block_precision_only(levels: LevelSet) -> None:
    log_scales = levels.shared.log_scales.copy()
    log_scales[0, 0] = 1e4
    given = replace(levels, shared=replace(levels.shared, log_scales=log_scales))
    data = encode_with_account(given, "compact", block=4)[0]
    read, plain = decode(data, "x"), decode(encode_with_account(levels, block=4)[0], "x")
    first = levels.levels[0].anchors
    assert (read.shared.log_scales[first:] == plain.shared.log_scales[first:]).all()
    assert (read.shared.log_scales[:, 1:] == plain.shared.log_scales[:, 1:]).all()


def test_rows_in_another_order_are_sorted(levels: LevelSet, rng: np.random.Generator) -> None:
    order = np.arange(len(levels.shared.lattice))
    start = 0
    for level in levels.levels:
        rng.shuffle(order[start : level.anchors])
        start = level.anchors
    s = levels.shared
    moved = replace(
        s,
        lattice=s.lattice[order],
        log_scales=s.log_scales[order],
        offsets=s.offsets[order],
        codes=s.codes[order],
        residual=s.residual[order],
    )
    inner = tuple(replace(x, mask=x.mask[order[: x.anchors]]) for x in levels.levels)
    mixed = replace(levels, shared=moved, levels=inner)
    assert (mixed.shared.lattice != levels.shared.lattice).any()
    assert encode(mixed) == encode(levels)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("coding", ["raw", "compact"])
def test_a_number_that_is_not_finite_is_not_written(
    levels: LevelSet, coding: str, value: float, tmp_path: Path
) -> None:
    log_scales = levels.shared.log_scales.copy()
    log_scales[-1, 2] = value
    bad = replace(levels, shared=replace(levels.shared, log_scales=log_scales))
    with pytest.raises(ValueRangeError, match=r"scene.gsyn: level 3 block 0: found (nan|inf)"):
        write_gsyn(bad, tmp_path / "scene.gsyn", coding)
    gain = np.array([1, 1, value], np.float32)
    bad = replace(levels, levels=(replace(levels.levels[0], gain=gain), *levels.levels[1:]))
    with pytest.raises(ValueRangeError, match="level 0: gain_z"):
        write_gsyn(bad, tmp_path / "scene.gsyn", coding)
    assert os.listdir(tmp_path) == []


def test_a_dead_slot_may_hold_anything(levels: LevelSet) -> None:
    offsets = levels.shared.offsets.copy()
    offsets[~levels.levels[-1].mask] = np.nan
    dirty = replace(levels, shared=replace(levels.shared, offsets=offsets))
    assert encode(dirty) == encode(levels)


@pytest.mark.parametrize("coding", ["raw", "compact"])
def test_encoding_does_not_touch_the_arrays_and_repeats_itself(
    levels: LevelSet, coding: str
) -> None:
    shared = levels.shared
    arrays = [shared.lattice, shared.log_scales, shared.offsets, shared.codes, shared.residual]
    arrays += shared.grids
    for level in levels.levels:
        arrays += [level.mask, level.codebook, level.gain, *level.networks.values()]
    before = [a.tobytes() for a in arrays]
    for array in arrays:
        array.flags.writeable = False
    assert encode(levels, coding) == encode(levels, coding)
    assert [a.tobytes() for a in arrays] == before


def with_shared(**fields: object) -> Callable[[LevelSet], LevelSet]:
    return lambda levels: replace(levels, shared=replace(levels.shared, **fields))


BEYOND: dict[str, tuple[Shape, Callable[[LevelSet], LevelSet], str]] = {
    "slots": (Shape(slots=257), lambda s: s, "slots: found 257"),
    "codebook": (Shape(entries=256), lambda s: wider_codebook(s), "codebook_rows: found 257"),
    "levels": (Shape((1,) * 17, grids=(1,) * 17), lambda s: s, "levels: found 17"),
    "hidden": (Shape(hidden=0), lambda s: s, "head_hidden: found 0"),
    "fusion": (Shape(fuse=(0, 3)), lambda s: s, "fuse_hidden: found 0"),
    "features": (Shape(features=0), lambda s: s, "features: found 0"),
    "resolutions": (
        Shape(),
        with_shared(grid_resolutions=(5, 5, 7)),
        "resolution: found 5, expected more than 5",
    ),
    "grid rows": (
        EMPTY,
        with_shared(grids=[np.zeros((0, 2), np.float32)]),
        "rows: found 0",
    ),
}


def wider_codebook(levels: LevelSet) -> LevelSet:
    codebook = np.zeros((257, 3), np.float32)
    return replace(levels, levels=tuple(replace(x, codebook=codebook) for x in levels.levels))


@pytest.mark.parametrize("name", BEYOND)
def test_what_is_beyond_a_limit_of_the_format_is_not_written(
    name: str, rng: np.random.Generator
) -> None:
    shape, change, message = BEYOND[name]
    with pytest.raises(LayoutError, match=message):
        encode(change(make_level_set(rng, shape)))


def test_a_coding_that_is_not_there_is_refused(levels: LevelSet) -> None:
    with pytest.raises(SettingError, match="found zip, expected raw or compact"):
        encode(levels, "zip")


def failing(code: int) -> Callable[..., None]:
    def fail(*args: object) -> None:
        raise OSError(code, os.strerror(code))

    return fail


@pytest.mark.parametrize("name", ["replace", "fsync"])
@pytest.mark.parametrize(
    ("code", "expected"),
    [(errno.ENOSPC, SpaceError), (errno.EDQUOT, SpaceError), (errno.EIO, InputError)],
)
def test_a_failure_leaves_the_old_file_and_nothing_else(
    name: str,
    code: int,
    expected: type[InputError],
    levels: LevelSet,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(b"the old one")
    monkeypatch.setattr(os, name, failing(code))
    with pytest.raises(expected) as caught:
        write_gsyn(levels, path)
    assert type(caught.value) is expected
    assert os.listdir(tmp_path) == ["scene.gsyn"]
    assert path.read_bytes() == b"the old one"


def test_an_interrupt_leaves_nothing(
    levels: LevelSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_gsyn(levels, tmp_path / "scene.gsyn")
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_seen_before_writing(
    levels: LevelSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage)
    with pytest.raises(SpaceError, match="found 1000 bytes, expected"):
        write_gsyn(levels, tmp_path / "scene.gsyn")
    assert os.listdir(tmp_path) == []


def test_a_missing_folder_is_one_clear_line(levels: LevelSet, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file or directory, expected a writable path"):
        write_gsyn(levels, tmp_path / "no" / "scene.gsyn")


def test_an_existing_file_is_replaced(levels: LevelSet, tmp_path: Path) -> None:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(b"the old one")
    assert isinstance(write_gsyn(levels, str(path)), SizeAccount)
    assert_same(read_gsyn(path), decode(encode(levels), "x"))
