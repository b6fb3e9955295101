"""The account of a level's blocks: every byte, every value, the error that a reader meets."""

from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.container import decode
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import ValueRangeError
from tests.level_sets import Shape, make_level_set


@pytest.mark.parametrize("coding", ["raw", "compact"])
def test_parts_add_up_to_the_file_and_levels_to_their_ends(coding: str) -> None:
    levels = make_level_set(np.random.default_rng(0), Shape(residual=3))
    data, account = encode_with_account(levels, coding, block=16)  # type: ignore[arg-type]
    assert account.total == len(data) == account.ends[-1]
    assert {part.level for part in account.parts} == {0, 1, 2, 3}
    assert all(part.stored > 0 and part.raw > 0 for part in account.parts)


def test_every_value_is_counted_once_and_errors_are_those_of_a_reader() -> None:
    levels = make_level_set(np.random.default_rng(0), Shape(residual=3))
    data, account = encode_with_account(levels, "compact", block=16)
    shared, read = levels.shared, decode(data, "a").shared
    for kind, values in (("log_scales", shared.log_scales), ("lattice", shared.lattice)):
        counted = sum(part.values for part in account.parts if part.kind == kind)
        assert counted == values.size, kind
    order = np.lexsort(read.lattice.T)
    given = np.lexsort(shared.lattice.T)
    away = np.abs(read.log_scales[order] - shared.log_scales[given]).max()
    assert account.error("log_scales") == pytest.approx(float(away), rel=1e-5)
    raw = encode_with_account(levels, "raw")[1]
    assert away > 0 and raw.error("log_scales") == 0


def test_a_value_that_is_not_finite_names_level_and_block() -> None:
    levels = make_level_set(np.random.default_rng(0))
    scales = levels.shared.log_scales.copy()
    scales[-1, 0] = np.nan
    broken = replace(levels, shared=replace(levels.shared, log_scales=scales))
    with pytest.raises(ValueRangeError, match="level 3 block 0"):
        encode_with_account(broken, "compact", "x.gsyn")
