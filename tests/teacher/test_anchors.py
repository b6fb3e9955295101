"""The closed form gives back the splats where anchors have values enough, and nearly where not."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gsynopsis.config import ModelConfig
from gsynopsis.model.splats import SplatModel
from gsynopsis.records import Frame, PlainGaussians
from gsynopsis.render.base import Gaussians
from gsynopsis.scene.camera import Camera
from gsynopsis.teacher import anchors
from gsynopsis.teacher.anchors import canonical, components, fitted_model
from gsynopsis.teacher.clusters import clustered, clusters_of, lattice_cell

SLOTS = 4
CONFIG = ModelConfig(
    fusion="none", grids=0, codebook=0, residual=11 * SLOTS, slots=SLOTS, hidden=22 * SLOTS
)
CAMERA = Camera(64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4))


@pytest.fixture
def splats(rng: np.random.Generator) -> PlainGaussians:
    count = 200
    means = rng.standard_normal((count, 3)) * 0.3 + (0, 0, 5)
    sh = 0.8 * rng.standard_normal((count, 1, 3)).clip(-1.5, 1.5)
    return PlainGaussians(
        means.astype(np.float32),
        (-3 + 0.5 * rng.standard_normal((count, 3)).clip(-2, 2)).astype(np.float32),
        rng.standard_normal((count, 4)).astype(np.float32),
        rng.uniform(-1.5, 1.5, count).astype(np.float32),
        sh.astype(np.float32),
    )


def covariances(gaussians: Gaussians) -> torch.Tensor:
    w, x, y, z = (gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    turn = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    sides = turn * gaussians.scales[:, None, :]
    return sides @ sides.transpose(1, 2)


def model_of(splats: PlainGaussians, config: ModelConfig):
    points = splats.means.astype(np.float64)
    label, count = clustered(points, SLOTS)
    voxel = lattice_cell(points, label, count)
    weights = np.ones(len(points))
    clusters = clusters_of(points, weights, label, count, voxel, SLOTS)
    frame = Frame(voxel, np.zeros(3), 10.0, False, 5.0)
    generator = torch.Generator().manual_seed(0)
    return fitted_model(splats, clusters, weights, frame, config, generator)


def test_with_as_many_values_as_splats_have_each_comes_back(splats: PlainGaussians) -> None:
    with torch.no_grad():
        truth, own = (m.decode(CAMERA) for m in (SplatModel(splats), model_of(splats, CONFIG)))
    assert len(own.means) == len(truth.means) == len(splats)
    away = (own.means[:, None] - truth.means).norm(dim=2)
    assert float(away.amin(dim=1).max()) < 1e-5
    pairs = away.argmin(dim=1)
    assert len(pairs.unique()) == len(splats)
    # Units that begin at random, view-dependent ones too, add a little.
    assert float((own.opacities - truth.opacities[pairs]).abs().max()) < 0.05
    assert float((own.colors - truth.colors[pairs].clamp(0, 1)).abs().max()) < 0.05
    theirs = covariances(truth)[pairs]
    error = (covariances(own) - theirs).flatten(1).norm(dim=1) / theirs.flatten(1).norm(dim=1)
    assert float(error.median()) < 0.1


def test_few_values_keep_what_counts_most(splats: PlainGaussians) -> None:
    few = replace(CONFIG, residual=8)
    with torch.no_grad():
        truth, own = (m.decode(CAMERA) for m in (SplatModel(splats), model_of(splats, few)))
    pairs = (own.means[:, None] - truth.means).norm(dim=2).argmin(dim=1)
    error = float((own.colors - truth.colors[pairs].clamp(0, 1)).square().mean().sqrt())
    spread = float(truth.colors.clamp(0, 1).std())
    assert error < 0.8 * spread


def test_a_few_anchors_at_a_time_begin_alike(
    splats: PlainGaussians, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = replace(CONFIG, residual=8)
    at_once = model_of(splats, few)
    monkeypatch.setattr(anchors, "ROWS", 7)
    assert len(at_once) > 7
    apart = model_of(splats, few)
    for name in ("offsets", "log_scales", "residual"):
        assert torch.allclose(getattr(apart, name), getattr(at_once, name), atol=1e-3), name


def test_axes_in_another_order_are_the_same_ellipsoid(rng: np.random.Generator) -> None:
    quats, scales = rng.standard_normal((50, 4)), np.exp(rng.standard_normal((50, 3)))
    turned = np.argsort(-scales, axis=1)
    sorted_scales = np.take_along_axis(scales, turned, axis=1)
    found = canonical(quats, turned)
    assert (found[:, 0] >= 0.5 - 1e-9).all(), "of four equal ones the nearest to no turn"

    def shape(q: np.ndarray, s: np.ndarray) -> torch.Tensor:
        n = torch.zeros(len(q), 3)
        turns, sizes = (torch.from_numpy(v).float() for v in (q, s))
        return covariances(Gaussians(n, turns, sizes, torch.zeros(len(q)), n))

    assert torch.allclose(shape(quats, scales), shape(found, sorted_scales), rtol=1e-3, atol=1e-3)


def test_components_are_exact_where_there_are_enough_and_do_not_see_what_is_missing(
    rng: np.random.Generator,
) -> None:
    values = (rng.standard_normal((60, 3)) @ rng.standard_normal((3, 9)) + 2).astype(np.float32)
    weights, own = np.ones((60, 9)), np.arange(9)
    scores, loadings, mean = components(values, weights, own, 3)
    assert np.allclose(scores @ loadings + mean, values, atol=1e-5)
    weights[rng.random(values.shape) < 0.1] = 0
    spoilt = np.where(weights > 0, values, np.float32(1e6))
    scores, loadings, mean = components(spoilt, weights, own, 3)
    found = scores @ loadings + mean
    assert np.abs(found - values)[weights > 0].mean() < 0.2
