"""Files whose rows are splats: decoded, refused and drawn as Python does."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.viewer.browser import MISSING, pages, pinhole, pixels, psnr, visit
from gsynopsis.container import decode, encode
from gsynopsis.container.writer import encode_with_account
from gsynopsis.model.splats import decoder_of
from gsynopsis.records import LevelSet
from gsynopsis.render.cpu import CpuRenderer
from tests.level_sets import PLAIN_SPLATS, SPLAT_SHAPES, SPLATS, STAND_INS, Shape, make_level_set
from tests.viewer.bright import LEAST_DB, camera_of
from tests.viewer.node import decode_with_viewer, needs_node, run_node
from tests.viewer.test_damage import assert_same_refusals
from tests.viewer.test_decoder import EYES, assert_gaussians, assert_tables
from tests.viewer.unseen import UNSEEN

pytestmark = needs_node
CASES = [(name, coding) for name in SPLAT_SHAPES for coding in ("raw", "compact")]


def test_splats_are_those_of_the_model(tmp_path: Path) -> None:
    files, sets = [], []
    for number, (name, coding) in enumerate(CASES):
        made = make_level_set(np.random.default_rng(number), SPLAT_SHAPES[name])
        files.append(tmp_path / f"{number}.gsyn")
        files[-1].write_bytes(encode(made, coding))  # type: ignore[arg-type]
        sets.append(decode(files[-1].read_bytes(), name))
    compared = 0
    found = decode_with_viewer(files, EYES, tmp_path, "wasm")
    for (name, _), levels, arrays in zip(CASES, sets, found, strict=True):
        assert_tables(name, levels, arrays)
        compared += assert_gaussians(name, levels, arrays)
    assert compared > 100


@pytest.mark.parametrize("name", SPLAT_SHAPES)
def test_changed_tables_of_splats_meet_the_same_refusal(name: str, tmp_path: Path) -> None:
    file = tmp_path / "whole.gsyn"
    made = make_level_set(np.random.default_rng(3), SPLAT_SHAPES[name])
    file.write_bytes(encode(made, "compact"))
    assert_same_refusals(file, 150)


@pytest.mark.parametrize(
    ("shape", "alike", "most"),
    [(PLAIN_SPLATS, True, 1), (SPLATS, True, 1), (STAND_INS, True, 2), (SPLATS, False, 9)],
    ids=["plain", "harmonics", "stand_ins", "gains"],
)
def test_a_block_has_those_splats_decoded_that_it_changes(
    shape: Shape, alike: bool, most: int, tmp_path: Path
) -> None:
    """Splats of coarser levels stay as they are, but where stand-ins go or levels have gains."""
    levels = bright_splats(shape)
    if alike:
        ones = np.ones(3, np.float32)
        levels = replace(levels, levels=tuple(replace(each, gain=ones) for each in levels.levels))
    path = tmp_path / "scene.gsyn"
    path.write_bytes(encode_with_account(levels, "compact", "scene", 32)[0])
    found = json.loads(run_node("block_changes.mjs", path))
    assert found["wrong"] == 0
    assert found["expected"] <= found["decoded"] <= most * found["expected"]
    assert (found["decoded"] > found["expected"]) == (most > 1)
    # Who sees no level between has the base decoded twice at most, and all else once.
    assert found["late"]["wrong"] == 0
    assert found["late"]["decoded"] <= min(most, 1.5) * found["expected"]
    # From the same eye nothing is decoded, but whoever asks is answered.
    assert found["waits"] == [False, True, True]
    assert found["pieces"][:2] == [0, 0]
    assert (found["pieces"][2] > 0) == (shape.degree != 0)


def bright_splats(shape: Shape = SPLATS) -> LevelSet:
    """Large, opaque and colourful, and other colours from elsewhere if there are harmonics."""
    levels = make_level_set(np.random.default_rng(4), replace(shape, anchors=(60, 120, 200, 400)))
    levels.shared.log_scales[:] += 1.5
    levels.shared.residual[:, 3] += 1.5
    return levels


@pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser")
@pytest.mark.parametrize(
    "shape", [SPLATS, PLAIN_SPLATS, STAND_INS], ids=["harmonics", "plain", "stand_ins"]
)
def test_every_level_of_splats_looks_as_the_cpu_renderer_draws_it(
    shape: Shape, tmp_path: Path
) -> None:
    """Blocks are small: levels come by what the policy asks for, not with the first request."""
    file = tmp_path / "scene.gsyn"
    data, _ = encode_with_account(bright_splats(shape), "compact", "scene", 32)
    file.write_bytes(data)
    levels = decode(file.read_bytes(), "scene")
    camera = camera_of(levels)
    steps = [{"wait": "complete"}]
    steps += [{"name": f"{k}", "script": f"picture({pinhole(camera)}, {k})"} for k in range(4)]
    with pages(file) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=UNSEEN)
    model = decoder_of(levels)
    for k in range(4):
        with torch.no_grad():
            image = CpuRenderer().render(model.decode(camera, k), camera, torch.zeros(3)).image
        expected = image.clamp(0, 1).numpy().astype(np.float64)
        assert expected.std() > 0.05
        assert psnr(pixels(found.results[f"{k}"]), expected) >= LEAST_DB, k
