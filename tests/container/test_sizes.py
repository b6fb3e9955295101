import zlib
from dataclasses import astuple, replace

import numpy as np
import pytest

from benchmarks.robust.forge import index_of
from gsynopsis.container import encode, measure
from gsynopsis.container.sizes import paper_rows, trained_note, trained_text
from gsynopsis.records import TRAINED_NOTE
from tests.level_sets import FREE, SHAPES, SPLAT_SHAPES, Shape, make_level_set


@pytest.mark.parametrize("name", [*SHAPES, *SPLAT_SHAPES])
def test_deltas_sum_to_what_the_files_hold(name: str, rng: np.random.Generator) -> None:
    levels = make_level_set(rng, {**SHAPES, **SPLAT_SHAPES}[name])
    rows = measure(levels)
    raw = [level.end for level in index_of(encode(levels, "raw")).levels]
    compact = [level.end for level in index_of(encode(levels, "compact")).levels]
    assert [row.bytes_raw for row in rows] == raw
    assert [row.bytes_compact for row in rows] == compact
    deltas = np.array([astuple(row)[7:] for row in rows])
    totals = np.array([astuple(row)[3:7] for row in rows])
    assert (np.cumsum(deltas, axis=0) == totals).all()
    assert [(r.anchors, r.slots) for r in rows] == [(x.anchors, x.live) for x in levels.levels]
    assert all(type(value) is int for row in rows for value in astuple(row))


def test_a_row_of_the_paper_is_157_bytes_and_its_mask(rng: np.random.Generator) -> None:
    """12 position + 24 log-scales + 120 offsets + 1 index (methods.md §1.14), and 10 bits."""
    shape = Shape(anchors=(8, 24), slots=10, grids=(1, 2), features=4)
    levels = make_level_set(rng, shape)
    sizes = measure(levels)
    networks = [sum(w.size for w in level.networks.values()) for level in levels.levels]
    shared = [
        4 * (n + level.codebook.size + 3) for n, level in zip(networks, levels.levels, strict=True)
    ]
    grids = [4 * grid.size for grid in levels.shared.grids]
    mask = [10, -(-(240 - levels.levels[0].live) // 8)]
    assert sizes[0].delta_paper == 8 * 157 + mask[0] + shared[0] + grids[0]
    assert sizes[1].delta_paper == 16 * 157 + mask[1] + shared[1] + grids[1]
    assert sizes[1].bytes_deflate == sum(
        len(zlib.compress(paper_rows(levels, k), 6)) for k in (0, 1)
    )


def test_a_splat_counts_with_its_harmonics_unfolded(rng: np.random.Generator) -> None:
    """12 position + 12 log-scales + 12 rotation + 4 opacity + 12 colours, 4 for each harmonic."""
    for shape in SPLAT_SHAPES.values():
        levels = make_level_set(rng, shape)
        counts = np.diff([0, *(level.anchors for level in levels.levels)])
        for size, count in zip(measure(levels), counts, strict=True):
            assert size.delta_paper == count * (52 + 4 * levels.shared.harmonics) + 12


def test_free_features_count_in_full(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, FREE)
    few = make_level_set(rng, Shape(grids=(0, 0, 0, 0), features=0, entries=0, code_width=0))
    rows = [paper_rows(levels, 0), paper_rows(few, 0)]
    weights = [sum(w.nbytes for w in x.levels[0].networks.values()) for x in (levels, few)]
    masks = [len(np.packbits(x.levels[0].mask)) for x in (levels, few)]
    left = [len(r) - w - m for r, w, m in zip(rows, weights, masks, strict=True)]
    assert left[0] - left[1] == 4 * 32 * levels.levels[0].anchors


def test_what_a_file_says_of_its_trained_values_counts(rng: np.random.Generator) -> None:
    levels = make_level_set(rng)
    count = len(levels.levels)
    told = [[100 + k, 50 + k, 70 + k] for k in range(count)]
    noted = replace(levels, meta={TRAINED_NOTE: trained_text(told)})
    rows = measure(noted)
    assert [[r.delta_paper, r.delta_deflate, r.delta_raw] for r in rows] == told
    assert rows[-1].bytes_deflate == sum(row[1] for row in told)
    # A prefix has the note of the whole file.
    assert trained_note(noted.meta, 1) == told[:1]


@pytest.mark.parametrize("text", ["", "[]", "[[1,2]]", "[[1,2,-3]]", "[[1,2,1e99]]", "[[" * 5000])
def test_a_note_that_is_none_is_left_aside(text: str) -> None:
    assert trained_note({TRAINED_NOTE: text}, 1) is None
