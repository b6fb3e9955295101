"""Octree-GS: lattices, which of them a camera sees, growth, levels."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.config import GrowthConfig
from gsynopsis.container import decode, encode
from gsynopsis.errors import DivergedError
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.growth import GrowthStatistics
from research.baselines.gaussians import Training
from research.baselines.octree import (
    NOTE,
    OctreeGate,
    OctreeModel,
    OctreeTraining,
    caps,
    find_finer,
    gate_text,
    gated,
    with_levels,
)

RENDERER = make_renderer("cpu")
GATE = OctreeGate(lattices=5, reach=16.0, opened=5)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("octree") / "room"
    return load_scene(make_scene("room", folder, views=10, width=48, height=32, points=300))


def training(scene: Scene, steps: int = 20) -> OctreeTraining:
    return OctreeTraining(scene, RENDERER, Training(steps, 1.0, most=100_000))


def test_twice_as_near_is_one_lattice_finer() -> None:
    distances = torch.tensor([100.0, 16.0, 11.5, 8.0, 4.0, 2.0, 1.0, 0.0])
    assert GATE.finest(distances).tolist() == [0, 0, 0, 1, 2, 3, 4, 4]
    assert OctreeGate(5, 16.0, 3).finest(distances).max() == 2


def test_lattices_are_counted_from_distances() -> None:
    eyes = np.array([[0.0, 0, 0]])
    points = np.stack([np.geomspace(1, 16, 9_000), np.zeros(9_000), np.zeros(9_000)], axis=1)
    gate = OctreeGate.of(points, eyes)
    assert gate.lattices == 5 and gate.reach == pytest.approx(16, rel=0.01)
    assert OctreeGate.of(np.ones((3, 3)), eyes).lattices == 1
    assert OctreeGate.of(np.zeros((3, 3)), eyes).lattices == 1


def test_lattices_open_one_after_the_other_and_all_at_a_quarter() -> None:
    opened = [GATE.at_progress(step / 1000).opened for step in range(1, 1001)]
    assert opened[0] == GATE.first + 1 and opened[249] == 5
    assert opened == sorted(opened)
    due = [opened.index(count) for count in (4, 5)]
    # The second waits as long as the first, divided by 1.5.
    assert (due[1] - due[0]) / due[0] == pytest.approx(1 / 1.5, abs=0.02)


def test_an_anchor_knows_its_lattice_and_lies_in_the_middle_of_its_cell() -> None:
    places = np.random.default_rng(0).uniform(-3, 3, (500, 3))
    half = 0.01
    for lattice in range(5):
        cells = GATE.cells(places, lattice, half)
        edge = 2 * half * 2 ** (4 - lattice)
        assert (np.abs(cells * half - places) <= edge / 2 + 1e-9).all()
        assert (GATE.lattice_of(torch.from_numpy(cells)) == lattice).all()
        inner = places - np.floor(places / edge) * edge
        assert np.allclose(cells * half - places, edge / 2 - inner)


def test_shares_are_of_the_cameras_near_enough() -> None:
    cells = GATE.cells(np.zeros((1, 3)), 3, 0.01)
    eyes = np.array([[0, 0, 1.0], [0, 0, 2.0], [0, 0, 4.0], [0, 0, 16.0]])
    assert GATE.shares(cells, eyes, 0.01).tolist() == [0.5]


def test_levels_end_with_evenly_spread_lattices() -> None:
    assert caps(10, 4) == [0, 3, 6, 9]
    assert caps(4, 4) == [0, 1, 2, 3]
    assert caps(3, 4) == [0, 1, 2]
    assert caps(1, 4) == [0]


def test_a_camera_sees_no_anchor_finer_than_its_distance(scene: Scene) -> None:
    model = training(scene).model
    camera = scene.camera(scene.train[0])
    rows = model.visible(model.part(-1), camera)
    away = (model.placed()[0] - torch.tensor(camera.position).float()).norm(dim=1)
    lattice = model.gate.lattice_of(model.lattice)
    drawn = lattice <= model.gate.finest(away)
    everything = super(OctreeModel, model).visible(model.part(-1), camera)
    expected = [row for row in everything.tolist() if drawn[row]]
    assert rows.tolist() == expected and 0 < len(expected) < len(everything)


def test_large_gradients_grow_finer_anchors_without_features(scene: Scene) -> None:
    found = training(scene)
    model, slots = found.model, found.model.slots
    with torch.no_grad():
        model.residual.fill_(1)
        model.offsets[0, 0] = 40.0
        model.offsets[1, 0] = -40.0
    statistics = GrowthStatistics.zeros(len(model), slots, torch.device("cpu"))
    config = GrowthConfig()
    lattice = model.gate.lattice_of(model.lattice)
    assert lattice[0] == lattice[1] == 0 and model.gate.opened > 1
    statistics.drawn[[0, slots]] = 1000
    statistics.gradient[0] = 1000 * config.threshold * 1.05
    statistics.gradient[slots] = 1000 * config.threshold * 2
    seeds, finer = find_finer(model, statistics, config)
    assert [len(s.cells) for s in seeds] == [1, 1] and finer == [1]
    assert [s.parent_of.tolist() for s in seeds] == [[0], [1]]
    of = [int(model.gate.lattice_of(torch.from_numpy(s.cells))) for s in seeds]
    assert of == [0, 1]
    edge = model.frame.voxel * 2**model.gate.lattices
    sizes = [math.exp(float(s.log_size[0])) for s in seeds]
    assert sizes == pytest.approx([edge, edge / 2], rel=1e-5)
    found.statistics, found.least_share = statistics, 0.0
    before = len(model)
    found._grow()
    assert len(model) == before + 2
    assert model.residual[before].eq(1).all() and model.residual[before + 1].eq(0).all()


def test_files_draw_by_distance_again_and_levels_nest(scene: Scene) -> None:
    found = training(scene)
    model = found.run(None)
    with_levels(model, 4)
    meta = {NOTE: gate_text(model.gate)}
    levels = decode(encode(model_to_levels(model, meta), "raw"), "scene")
    counts = [level.anchors for level in levels.levels]
    lattice = model.gate.lattice_of(model.lattice)
    assert counts == [int((lattice <= cap).sum()) for cap in caps(model.gate.lattices, 4)]
    assert levels.inherits(len(levels.levels) - 1)
    again = gated(model_from_levels(levels), levels.meta)
    plain = model_from_levels(levels)
    camera = scene.camera(scene.test[0])
    for number in range(len(counts)):
        trained = len(model.decode(camera, number).means)
        assert len(again.decode(camera, number).means) == trained
    assert len(plain.decode(camera).means) > len(again.decode(camera).means)
    assert gated(plain, {}) is plain


def test_two_trainings_of_one_seed_are_alike(scene: Scene) -> None:
    found = [training(scene, 30).run(None) for _ in range(2)]
    for name, value in found[0].state_dict().items():
        assert torch.equal(value, found[1].state_dict()[name])


def test_what_is_not_finite_is_said(scene: Scene) -> None:
    found = training(scene)
    with torch.no_grad():
        found.model.part(-1).networks["opacity_w2"].fill_(torch.nan)
    with pytest.raises(DivergedError, match="step 1 is not finite"):
        found.run(None)


def test_a_scene_becomes_a_report(scene: Scene, tmp_path: Path) -> None:
    from research.baselines.methods import Task
    from research.baselines.train import run_baseline

    report = run_baseline("octree", Task(scene, RENDERER, 1.0, 150, 100), tmp_path)
    psnr = [level.quality.psnr_full for level in report.levels]
    assert psnr[-1] > psnr[0] and psnr[-1] > 15


@pytest.mark.parametrize("gate", [OctreeGate(5, 16.0, 4), OctreeGate(1, 16.0, 1)])
def test_large_gradients_grow_nothing_before_all_lattices_are_open_nor_on_the_last(
    gate: OctreeGate, scene: Scene
) -> None:
    model = OctreeModel.of(training(scene).model, gate)
    slots, config = model.slots, GrowthConfig()
    with torch.no_grad():
        model.offsets[0, 0] = 40.0
    statistics = GrowthStatistics.zeros(len(model), slots, torch.device("cpu"))
    statistics.drawn[0] = 1000
    lattice = int(gate.lattice_of(model.lattice)[0]) if gate.lattices > 1 else 0
    if gate.lattices == 1:
        model.set_lattice(model.lattice | 1)
    least = config.threshold * 2 ** (0.2 * lattice)
    statistics.gradient[0] = 1000 * least * 2
    assert find_finer(model, statistics, config) == ([], [])
    statistics.gradient[0] = 1000 * least * 1.05
    seeds, finer = find_finer(model, statistics, config)
    assert [len(found.cells) for found in seeds] == [1] and not finer


def test_the_result_is_the_mean_of_the_last_weights(scene: Scene) -> None:
    found, values = training(scene, 20), list[torch.Tensor]()
    model = found.run(lambda *_: values.append(found.model.offsets.detach().clone()))
    assert torch.allclose(model.offsets, torch.stack(values[17:]).mean(dim=0), atol=1e-6)
