from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import (
    annotated,
    check_file,
    cut_file,
    decode,
    describe,
    read_gsyn,
    split_file,
)
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import FormatError, InputError, ValueRangeError
from tests.level_sets import BOTH, assert_same, make_level_set

VECTORS = Path(__file__).parent / "vectors"


@pytest.fixture
def path(rng: np.random.Generator, tmp_path: Path) -> Path:
    found = tmp_path / "scene.gsyn"
    found.write_bytes(encode_with_account(make_level_set(rng, BOTH), block=8)[0])
    return found


def annotate(
    path: Path, meta: dict[str, str], quality: list[dict[str, float]] | None = None
) -> None:
    path.write_bytes(annotated(path.read_bytes(), meta, quality, str(path)))


def test_notes_and_quality_change_nothing_else(path: Path) -> None:
    before, old = read_gsyn(path), path.read_bytes()
    quality = [{"psnr_full": 20.0 + k} for k in range(4)]
    annotate(path, {"licence": "CC0", "scene": "other"}, quality)
    after = read_gsyn(path)
    assert after.meta == {**before.meta, "licence": "CC0", "scene": "other"}
    assert [dict(level.quality) for level in after.levels] == quality
    assert (after.shared.offsets == before.shared.offsets).all()
    assert path.read_bytes()[-1000:] == old[-1000:]
    annotate(path, {"units": "metres"})
    assert [dict(level.quality) for level in read_gsyn(path).levels] == quality


def test_wrong_notes_are_refused(path: Path) -> None:
    old = path.read_bytes()
    for meta, quality in (
        ({}, [{"psnr_full": float("nan")}] * 4),
        ({}, [{}]),
        ({"scene": "x" * 70_000}, None),
    ):
        with pytest.raises(ValueRangeError):
            annotated(old, meta, quality, str(path))
    assert path.read_bytes() == old


def test_a_prefix_can_be_annotated(path: Path) -> None:
    end = describe(path).levels[1].bytes
    path.write_bytes(path.read_bytes()[:end])
    annotate(path, {"licence": "CC0"})
    assert len(read_gsyn(path).levels) == 2


def test_a_cut_is_the_file_of_that_level(path: Path, tmp_path: Path) -> None:
    for level in range(4):
        length = cut_file(path, level, tmp_path / "cut.gsyn")
        assert length == describe(path).levels[level].bytes
        assert_same(read_gsyn(tmp_path / "cut.gsyn"), read_gsyn(path, level))
    with pytest.raises(InputError, match="level: found 4"):
        cut_file(path, 4, tmp_path / "cut.gsyn")


def test_a_file_of_splats_is_cut_and_split_as_any(tmp_path: Path) -> None:
    path = VECTORS / "splats-compact.gsyn"
    for level in range(len(describe(path).levels)):
        cut_file(path, level, tmp_path / "cut.gsyn")
        assert_same(read_gsyn(tmp_path / "cut.gsyn"), read_gsyn(path, level))
    pieces = split_file(path, tmp_path)
    assert b"".join(p.path.read_bytes() for p in pieces) == path.read_bytes()


def test_the_pieces_of_a_split_are_the_file(path: Path, tmp_path: Path) -> None:
    pieces = split_file(path, tmp_path)
    assert [p.path.name for p in pieces] == [
        "scene.L0.gsyn",
        "scene.L1.delta",
        "scene.L2.delta",
        "scene.L3.delta",
    ]
    joined = b"".join(p.path.read_bytes() for p in pieces)
    assert joined == path.read_bytes()
    assert_same(read_gsyn(pieces[0].path), read_gsyn(path, 0))


def test_a_damaged_file_is_neither_checked_nor_cut_nor_split(path: Path, tmp_path: Path) -> None:
    assert_same(check_file(path), decode(path.read_bytes(), "x"))
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    before = sorted(tmp_path.iterdir())
    for act in (
        lambda: check_file(path),
        lambda: cut_file(path, 0, tmp_path / "cut.gsyn"),
        lambda: split_file(path, tmp_path),
    ):
        with pytest.raises(FormatError):
            act()
    assert sorted(tmp_path.iterdir()) == before
    with pytest.raises(InputError, match="readable"):
        check_file(tmp_path / "no.gsyn")
