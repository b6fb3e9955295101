"""Lines after a training on levels that are not as they were ordered."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gsynopsis.container import encode
from gsynopsis.container.info import LevelInfo, describe
from gsynopsis.jobs.train_run import size_notes
from tests.level_sets import Shape, make_level_set


def levels_of(tmp_path: Path) -> list[LevelInfo]:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(encode(make_level_set(np.random.default_rng(0), Shape()), "raw"))
    return list(describe(path).levels)


def test_levels_that_meet_their_sizes_are_not_worth_a_line(tmp_path: Path) -> None:
    levels = levels_of(tmp_path)
    assert size_notes(levels, [level.bytes for level in levels]) == []
    assert size_notes(levels, []) == []


def test_sizes_that_are_missed_are_named_with_both_figures(tmp_path: Path) -> None:
    levels = levels_of(tmp_path)
    small, large = size_notes(levels, [4 * levels[0].bytes, levels[1].bytes // 4])
    assert small.startswith("levels: sizes below target, all anchors used: L0 ")
    assert large.startswith("levels: sizes above target, minimum reached: L1 ")


def test_a_level_that_adds_no_gaussian_is_named(tmp_path: Path) -> None:
    levels = levels_of(tmp_path)
    levels[1] = replace(levels[1], slots=levels[0].slots)
    assert size_notes(levels, []) == ["levels: no Gaussians beyond the level below: L1"]
