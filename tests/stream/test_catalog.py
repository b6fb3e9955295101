"""Tables of a catalog against loops over its items."""

import numpy as np
import pytest

from gsynopsis.stream.catalog import SHARED, Catalog, Key, catalog_of, errors_of
from gsynopsis.stream.policy import State, levels_now, missing
from gsynopsis.stream.views import ViewPose, covered, covered_by
from tests.stream.scenes import assembler_of_small_file, hand_made, state_of

ERRORS = (1e-2, 1e-3, 1e-5)
SIZES = {(level, leaf): 1000 for level in (1, 2) for leaf in range(3)}
CATALOGS = {
    "blocks": catalog_of(assembler_of_small_file()),
    "whole levels": catalog_of(assembler_of_small_file(), by_blocks=False),
    "by hand": hand_made(SIZES, ERRORS, 3, (500, 100, 100)),
}


@pytest.fixture(params=CATALOGS)
def catalog(request: pytest.FixtureRequest) -> Catalog:
    return CATALOGS[request.param]


def shares_of(catalog: Catalog) -> np.ndarray:
    return np.random.default_rng(5).dirichlet(np.ones(catalog.leaves))


def test_what_items_take_of_a_picture_and_off_its_error(catalog: Catalog) -> None:
    share, errors = shares_of(catalog), catalog.leaf_errors
    seen, lower = catalog.covered(share), catalog.lowered(share)
    for row, (key, item) in enumerate(catalog.items.items()):
        assert catalog.rows[key] == row
        assert catalog.sizes[row] == item.stop - item.start
        assert seen[row] == pytest.approx(sum(share[leaf] for leaf in item.region))
        taken = [
            share[leaf] * (errors[key.level - 1, leaf] - errors[key.level, leaf])
            for leaf in item.region
            if key.level
        ]
        assert lower[row] == pytest.approx(sum(taken))
    assert lower.max() > 0


def test_items_bring_the_leaves_of_their_regions_to_their_level(catalog: Catalog) -> None:
    for row, (key, item) in enumerate(catalog.items.items()):
        own = np.isin(np.arange(catalog.leaves), item.region)
        assert (catalog.brings[row, own] == catalog.leaf_errors[key.level, own]).all()
        assert np.isinf(catalog.brings[row, ~own]).all()


def test_the_parent_of_a_block_is_what_it_needs_of_the_level_above(catalog: Catalog) -> None:
    blocks = [key for key in catalog.items if key.level and key.block != SHARED]
    assert list(catalog.parents) == blocks
    for key in blocks:
        parent = catalog.parents[key]
        assert parent in catalog.items[key].needs
        assert parent.level == key.level - 1


def test_levels_now_are_the_finest_of_what_is_there(catalog: Catalog) -> None:
    share = [shares_of(catalog).tolist()]
    order = missing(state_of(catalog, share, held=()), catalog.items)
    rng = np.random.default_rng(6)
    for count in (0, 1, len(order) // 2, len(order)):
        held = frozenset(order[:count])
        asked = frozenset(key for key in order[count:] if rng.random() < 0.5)
        state = state_of(catalog, share, held=tuple(held))
        state = State(catalog, held, asked, state.samples, state.shares, state.moments)
        for have, found in (
            (held | asked, levels_now(state)),
            (held, levels_now(state, asked=False)),
        ):
            for leaf in range(catalog.leaves):
                levels = [k.level for k in have if leaf in catalog.items[k].region]
                assert found[leaf] == max(levels, default=-1)
        for leaf, level in enumerate(levels_now(state)):
            assert state.errors[leaf] == (catalog.leaf_errors[level, leaf] if level >= 0 else 1)


def test_parts_that_are_kept_cover_what_boxes_do(catalog: Catalog) -> None:
    w2c = np.eye(4)
    w2c[2, 3] = 2.0
    eye = ViewPose(w2c, 0.7, 0.5)
    found = covered_by(catalog.parts, eye)
    assert (found == covered(catalog.low, catalog.high, eye)).all()
    assert found.sum() == pytest.approx(1)


def test_errors_of_a_measured_file_are_those_of_its_table() -> None:
    catalog = CATALOGS["by hand"]
    assert catalog.leaf_errors.tolist() == [[error] * 3 for error in ERRORS]
    table = np.arange(9.0).reshape(3, 3)
    told = Catalog(catalog.items, catalog.errors, catalog.low, catalog.high, table)
    assert told.leaf_errors.tolist() == table.tolist()
    assert told.brings[told.rows[Key(2, 1)], 1] == 7


def test_figures_that_nobody_can_have_measured_count_as_the_largest_that_make_sense() -> None:
    errors = errors_of([-5000.0, 20.0, 9e9])
    assert np.isfinite(errors).all() and (np.diff(errors) <= 0).all()
