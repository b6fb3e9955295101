"""Growing and pruning keep the books straight."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.config import RATES, GrowthConfig
from gsynopsis.model.lattice import growth_cells, lattice_keys
from gsynopsis.render.base import Rendering
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.growth import LEVELS, GrowthStatistics, adjust, find_seeds, growth_limit
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent, StepInfo
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.optim.param_groups import part_parameters, rates_of, shared_parameters
from gsynopsis.training.view_step import count_view
from tests.tiny import tiny_config, tiny_model, tiny_scene

GROWTH = GrowthConfig(every=10, threshold=1e-4, grow_visits=0.1, prune_visits=0.2)


def prepared() -> tuple:
    model = tiny_model()
    parameters = shared_parameters(model) | part_parameters(model.part(-1), "", level_scale=False)
    optimizer = Optimizer(parameters, rates_of(parameters, RATES["paper"], 1.0, False))
    for parameter in parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    statistics = GrowthStatistics.zeros(len(model), model.slots, torch.device("cpu"))
    statistics.drawn += 5
    statistics.visits += 5
    statistics.opacity += 1
    statistics.gradient[::3] = 1.0
    return model, optimizer, statistics


@pytest.mark.parametrize("threads", [1, 3])
def test_a_view_is_counted_as_in_pytorch(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gsynopsis.training.view_step.thread_count", lambda: threads)
    model, scene, renderer = tiny_model(), tiny_scene(points=900), make_renderer("cpu")
    native, plain = (
        GrowthStatistics.zeros(len(model), model.slots, torch.device("cpu")) for _ in range(2)
    )
    for view in scene.train[:4]:
        camera = scene.camera(view)
        decoded = model.decode_level(-1, camera)
        rendering = renderer.render(decoded.gaussians, camera, torch.zeros(3))
        rendering.image.square().sum().backward()
        size = camera.width, camera.height
        count_view(native, decoded, rendering)
        plain.count(decoded, rendering.screen_grad(), rendering.visible, size)
    assert plain.visits.max() > 1 and plain.drawn.sum() > 10 and plain.gradient.max() > 0
    assert torch.equal(native.drawn, plain.drawn) and torch.equal(native.visits, plain.visits)
    torch.testing.assert_close(native.gradient, plain.gradient, rtol=1e-6, atol=0)
    torch.testing.assert_close(native.opacity, plain.opacity, rtol=1e-6, atol=0)


def test_what_is_not_of_the_model_is_not_counted() -> None:
    model = tiny_model()
    statistics = GrowthStatistics.zeros(len(model), model.slots, torch.device("cpu"))
    camera = tiny_scene().camera(1)
    decoded = model.decode_level(-1, camera)
    count, nothing = len(decoded.slots), torch.zeros(len(decoded.slots), 2)
    wrong = replace(decoded, slots=decoded.slots + len(model) * model.slots)
    shown = torch.ones(count, dtype=torch.bool)
    image = Rendering(torch.zeros(9, 9, 3), torch.zeros(9, 9), shown, lambda: nothing)
    with pytest.raises(ValueError, match="ascending rows of the tables"):
        count_view(statistics, wrong, image)
    assert not statistics.drawn.any()


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def grown(config: GrowthConfig, seed: int = 0) -> tuple:
    model, optimizer, statistics = prepared()
    before = model.lattice.clone()
    generator = torch.Generator().manual_seed(seed)
    seeds = find_seeds(model, statistics, config, generator)
    after = adjust(model, optimizer, statistics, config, seeds)
    return model, optimizer, after, before


def test_growth_adds_anchors_and_never_a_cell_twice() -> None:
    model, _, statistics, before = grown(GROWTH)
    assert len(model) > len(before)
    assert len(np.unique(lattice_keys(model.lattice.numpy()))) == len(model)
    assert len(statistics.visits) == len(model)
    assert len(statistics.gradient) == len(model) * model.slots == len(statistics.drawn)


def test_new_anchors_lie_on_the_lattice_of_their_growth_level() -> None:
    model, _, _, before = grown(GROWTH)
    fresh = model.lattice[len(before) :]
    sizes = torch.round(model.log_scales[len(before) :, 0].exp() / model.frame.voxel).long()
    assert set(sizes.tolist()) <= {16, 4, 1} and bool((fresh % sizes[:, None] == 0).all())


def by_scaffolds_rule(
    anchors: list[tuple[int, ...]], wanted: np.ndarray, cell: int
) -> set[tuple[int, ...]]:
    """Plain transcription: a candidate is dropped if any anchor rounds into its cell."""
    taken = {tuple(round(v / cell) for v in anchor) for anchor in anchors}
    return {tuple(int(v) for v in row) for row in wanted} - taken


@pytest.mark.parametrize("seed", range(8))
def test_growth_cells_are_free_by_scaffolds_rule_at_all_growth_levels(seed: int) -> None:
    model, _, statistics = prepared()
    rng = np.random.default_rng(seed)
    anchors = np.unique(rng.integers(-40, 40, (len(model), 3)), axis=0)
    anchors = np.resize(anchors, (len(model), 3))
    model.set_lattice(torch.from_numpy(anchors.astype(np.int64)))
    model.offsets.data = torch.from_numpy(rng.normal(0, 30, model.offsets.shape)).float()
    with torch.no_grad():
        x, _ = model.placed()
        centers = x[:, None] + model.offsets * model.log_scales[:, None, :3].exp()
    everything = GrowthConfig(every=1, threshold=0, grow_visits=0.1)
    generator, there = torch.Generator().manual_seed(seed), [tuple(a) for a in anchors.tolist()]
    luck = torch.Generator().manual_seed(seed)
    grown_cells = 0
    for depth, seeds in enumerate(find_seeds(model, statistics, everything, generator)):
        cell = 16 // 4**depth
        drawn = torch.rand(model.offsets[..., 0].numel(), generator=luck) > 0.5 ** (depth + 1)
        chosen = centers.reshape(-1, 3)[drawn].double()
        wanted = torch.round(chosen / (model.frame.voxel * cell)).numpy()
        expected = by_scaffolds_rule(there, wanted, cell)
        found = {tuple(c // cell for c in row) for row in seeds.cells.tolist()}
        assert found == expected
        there += [tuple(row) for row in seeds.cells.tolist()]
        grown_cells += len(found)
    assert grown_cells > 100


def test_an_anchor_takes_the_cell_into_which_it_rounds() -> None:
    lattice = np.array([[16, 0, 0], [1, 0, 0], [-17, 0, 0], [8, 24, -8]])
    assert growth_cells(lattice, 16).tolist() == [[1, 0, 0], [0, 0, 0], [-1, 0, 0], [0, 2, 0]]


def test_nothing_grows_beyond_what_a_key_holds() -> None:
    model, _, statistics = prepared()
    model.offsets.data += 1e9
    seeds = find_seeds(model, statistics, GROWTH, seeded())
    assert sum(len(s.cells) for s in seeds) == 0


def test_all_growth_levels_run_even_when_the_coarsest_adds_nothing() -> None:
    model, _, statistics = prepared()
    fine_only = GrowthConfig(every=10, threshold=1e-4, grow_visits=0.1)
    coarse = torch.round(model.lattice / 16).long() * 16
    model.set_lattice(torch.unique(torch.cat([model.lattice, coarse]), dim=0)[: len(model)])
    seeds = find_seeds(model, statistics, fine_only, torch.Generator().manual_seed(0))
    assert len(seeds) == LEVELS


def test_new_rows_have_no_moments_and_old_rows_keep_theirs() -> None:
    model, optimizer, _, before = grown(GROWTH)
    moments = optimizer.state[model.log_scales]["exp_avg"]
    assert bool((moments[: len(before)] == 0.1).all()) and not moments[len(before) :].any()
    assert optimizer.parameter("log_scales") is model.log_scales


def test_new_features_are_the_maximum_over_the_parents() -> None:
    model, _, statistics = prepared()
    seeds = find_seeds(model, statistics, GROWTH, torch.Generator().manual_seed(0))[0]
    logits = model.logits.detach().clone()
    model, _, _, before = grown(GROWTH)
    row = int(seeds.row_of[0])
    parents = seeds.parent_of[seeds.row_of == row]
    assert torch.equal(model.logits[len(before) + row], logits[parents].amax(dim=0))


def test_transparent_anchors_are_pruned_and_never_all() -> None:
    model, optimizer, statistics = prepared()
    count = len(model)
    statistics.opacity[:50] = 0
    left = adjust(model, optimizer, statistics, GROWTH, [])
    assert len(model) == count - 50 == len(left.visits)
    model, optimizer, statistics = prepared()
    statistics.opacity[:] = 0
    adjust(model, optimizer, statistics, GROWTH, [])
    assert len(model) == count


def test_growth_stops_at_the_limit() -> None:
    limit = GrowthConfig(every=10, threshold=1e-4, grow_visits=0.1, max_anchors=130)
    model, *_ = grown(limit)
    assert len(model) == 130


def test_nothing_grows_beyond_what_an_image_can_tell_apart(tmp_path: Path) -> None:
    config = tiny_config(steps=1)
    growth = replace(config.train.growth, threshold=0.0, per_pixel=0.148)
    config = replace(config, train=replace(config.train, growth=growth))
    scene = tiny_scene(points=60)
    assert growth_limit(scene, config) == 57  # of 24 × 16 pixels, rounded up
    assert growth_limit(scene, replace(config, scale=2)) == 15
    free = replace(config.train, growth=replace(growth, per_pixel=0.0))
    assert growth_limit(scene, replace(config, train=free)) == growth.max_anchors
    counts: list[int] = []

    class Watch(Silent):
        def on_step(self, info: StepInfo) -> None:
            counts.append(info.anchors)

    state = open_state(TrainContext(scene, config, make_renderer("cpu")), tmp_path, Silent())
    assert run_training(state, tmp_path, Watch(), lambda: False)
    assert counts[0] < 57 == max(counts)


def test_at_the_limit_the_largest_gradients_grow() -> None:
    """Not the smallest coordinates, which stand first."""
    model, optimizer, statistics = prepared()
    before = model.lattice.clone()
    strength = torch.linspace(0.1, 1.0, len(statistics.gradient))
    statistics.gradient += strength[torch.randperm(len(strength), generator=seeded())]
    limit = GrowthConfig(every=10, threshold=1e-4, grow_visits=0.1, max_anchors=len(before) + 10)
    seeds = find_seeds(model, statistics, limit, seeded())
    offered = torch.cat([s.gradient for s in seeds])
    cells = np.concatenate([s.cells for s in seeds])
    assert len(offered) > 20
    adjust(model, optimizer, statistics, limit, seeds)
    added = {tuple(cell) for cell in model.lattice[len(before) :].tolist()}
    best = torch.sort(offered, descending=True, stable=True).indices[:10].tolist()
    assert added == {tuple(cells[k].tolist()) for k in best}


def test_counters_that_were_judged_start_again() -> None:
    _, _, statistics, before = grown(GROWTH)
    assert not statistics.drawn[: len(before)].any() and not statistics.visits.any()
