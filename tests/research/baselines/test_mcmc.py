"""3DGS-MCMC: copies look like what they copy, dead ones move, growth ends at the cap, noise."""

from math import comb, sqrt
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from research.baselines import mcmc
from research.baselines.gaussians import Training, from_points, rotation
from research.baselines.mcmc import DEAD, MOST_COPIES, McmcTrainer, relocated, train_mcmc

RENDERER = make_renderer("cpu")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("mcmc") / "room"
    return load_scene(make_scene("room", folder, views=6, width=24, height=16, points=80))


def trainer(scene: Scene, most: int = 10_000, steps: int = 1000) -> McmcTrainer:
    training = Training(steps, 1, grow=True, most=most)
    return McmcTrainer(from_points(scene, 1), scene, RENDERER, training)


def test_copies_are_those_of_the_papers_double_sum() -> None:
    opacities = torch.tensor([0.02, 0.3, 0.7, 0.97, 0.5])
    copies = torch.tensor([1, 2, 5, 3, MOST_COPIES])
    own, factors = relocated(opacities, copies)
    for o, n, found, factor in zip(opacities.tolist(), copies.tolist(), own, factors, strict=True):
        expected = 1 - (1 - o) ** (1 / n)
        total = sum(
            comb(i - 1, k) * (-1) ** k * expected ** (k + 1) / sqrt(k + 1)
            for i in range(1, n + 1)
            for k in range(i)
        )
        assert float(found) == pytest.approx(expected, rel=1e-5)
        assert float(factor) == pytest.approx(o / total, rel=1e-4)


def test_copies_cover_along_a_line_what_the_one_did() -> None:
    """The paper's condition: the integral through the centre stays."""
    x = np.linspace(-30, 30, 60_001)
    for opacity, copies in ((0.4, 3), (0.9, 2)):
        own, factor = relocated(torch.tensor([opacity]), torch.tensor([copies]))
        before = opacity * np.exp(-(x**2) / 2)
        after = 1 - (1 - float(own) * np.exp(-(x**2) / 2 / float(factor) ** 2)) ** copies
        assert after.sum() == pytest.approx(before.sum(), rel=1e-4)
        assert after.max() == pytest.approx(opacity, rel=1e-5)


def test_dead_ones_move_to_where_others_are(scene: Scene) -> None:
    own = trainer(scene)
    with torch.no_grad():
        own.model.logits[:7] = -9
        own.model.logits[7:] = 0.5
    places = {tuple(row) for row in own.model.means[7:].tolist()}
    count = len(own.model.means)
    own._relocate()
    assert len(own.model.means) == count
    assert all(tuple(row) in places for row in own.model.means[:7].tolist())
    opacities = own.model.logits.sigmoid()
    assert (opacities > DEAD).all() and int((opacities < 0.6).sum()) >= 8


def test_it_multiplies_up_to_the_cap(scene: Scene) -> None:
    own = trainer(scene)
    count = len(own.model.means)
    own._add()
    assert len(own.model.means) == int(1.05 * count)
    own.training = Training(1000, 1, grow=True, most=count + 6)
    own._add()
    own._add()
    assert len(own.model.means) == int(1.05 * count), "beyond the cap nothing is added"


def test_noise_is_loud_where_a_gaussian_is_faint_and_has_its_shape(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = trainer(scene)
    with torch.no_grad():
        own.model.quaternions.copy_(torch.randn(own.model.quaternions.shape, generator=own.luck))
        own.model.logits[0], own.model.logits[1:] = -9, 4
        own.model.log_scales[0] = torch.tensor([-1.0, -2.0, -3.0])
    before = own.model.means.detach().clone()
    drawn = torch.randn(1, 3, generator=torch.Generator().manual_seed(5))
    own.luck = torch.Generator().manual_seed(5)
    own.optimizer.set_progress(0)
    own._drift()
    moved = own.model.means.detach() - before
    assert not moved[1:].any()
    turn = rotation(own.model.quaternions[:1].detach())[0]
    covariance = turn @ torch.diag((2 * own.model.log_scales[0].detach()).exp()) @ turn.T
    unit = mcmc.UNIT_EXTENT / scene.extent
    faint = 1 / (1 + np.exp(-100 * (1 - float(own.model.logits[0].detach().sigmoid()) - 0.995)))
    rate = 1.6e-4 * scene.extent
    expected = covariance @ drawn[0] * faint * 5e5 * rate * unit**2
    assert torch.allclose(moved[0], expected, rtol=1e-3)


def test_a_seed_gives_the_same_bits_and_photos_come_nearer(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(mcmc, "EVERY", 10)
    training = Training(60, 1, grow=True, rates=4, most=400)
    one, two = (train_mcmc(scene, RENDERER, training, 1) for _ in range(2))
    for a, b in zip(vars(one).values(), vars(two).values(), strict=True):
        assert np.array_equal(a, b) and np.isfinite(a).all()
    assert 200 < len(one) <= 400 and one.degree == 1
