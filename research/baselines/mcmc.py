"""3DGS-MCMC: Gaussians that relocate, drift and multiply up to a cap (methods.md §6.8).

Written from the paper: S. Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo",
NeurIPS 2024. Letters: G Gaussians.
"""

from collections.abc import Callable
from dataclasses import replace
from math import comb, sqrt

import numpy as np
import torch
from torch import Tensor

from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import Renderer
from gsynopsis.scene.scene import Scene
from gsynopsis.training.optim.adam import MOMENTS
from research.baselines.gaussians import EVERY, GROW_FROM, Trainer, Training, from_points, rotation

GROW_UNTIL = 25 / 30
"""Share of the steps at which relocation and growth end."""
GROWTH = 0.05
"""Share of the Gaussians that each adjustment adds, up to the cap."""
DEAD = 0.005
"""Opacity up to which a Gaussian is moved to where others are."""
FIRST_OPACITY, FIRST_SCALE = 0.5, 0.1
"""Opacities begin at the first; scales at the second of the distance to the neighbours."""
OPACITY_WEIGHT, SCALE_WEIGHT = 0.01, 0.01
"""Weights of the mean opacity and of the mean scale in the loss."""
NOISE, STEEP, FAINT = 5e5, 100.0, 0.995
"""Factor of the noise on the means' learning rate; slope and middle of the logistic curve by which
it fades as a Gaussian becomes opaque."""
UNIT_EXTENT = 5.0
"""Extent that scenes count as for noise and the scale term, which depend on the world's unit: about
that of the published scenes (ours)."""
MOST_COPIES = 51
"""Most Gaussians that take the place of one at once."""


def train_mcmc(
    scene: Scene,
    renderer: Renderer,
    training: Training,
    degree: int,
    tick: Callable[[int, int], None] | None = None,
) -> PlainGaussians:
    """Train Gaussians from a scene's points, `training.most` of them at most.

    Args:
        scene: Photos and cameras.
        renderer: With gradients.
        training: Settings; those of cloning, splitting and resets have no effect.
        degree: Of the spherical harmonics.
        tick: Called with steps done and steps in all.

    Raises:
        DivergedError: a loss is not finite.
        SceneError: a photo cannot be decoded.
    """
    start = from_points(scene, degree)
    opaque = np.full(len(start), np.log(FIRST_OPACITY / (1 - FIRST_OPACITY)), np.float32)
    small = start.log_scales + np.float32(np.log(FIRST_SCALE))
    start = replace(start, logits=opaque, log_scales=small)
    return McmcTrainer(start, scene, renderer, training).run(tick)


def relocated(opacities: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity and scale of each of the copies that together look like one Gaussian.

    With n copies at the same place an opacity is o' = 1 - (1 - o)^(1/n), and scales are multiplied
    by o / Σ_{i=1..n} Σ_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / √(k+1).

    Args:
        opacities: In (0, 1) [G].
        copies: n, 1 to `MOST_COPIES`, int64 [G].

    Returns:
        o' [G] and the factors on the scales [G].
    """
    wide = opacities.double()
    own = 1 - (1 - wide) ** (1 / copies.double())
    # Σ_{i=1..n} C(i-1, k) = C(n, k+1)
    terms = torch.tensor(
        [
            [comb(n, k + 1) * (-1) ** k / sqrt(k + 1) for k in range(MOST_COPIES)]
            for n in range(MOST_COPIES + 1)
        ],
        dtype=torch.float64,
        device=opacities.device,
    )
    powers = own[:, None] ** torch.arange(1, MOST_COPIES + 1, device=own.device)
    total = (terms[copies] * powers).sum(dim=1)
    return own.to(opacities), (wide / total).to(opacities)


class McmcTrainer(Trainer):
    """Relocation, growth to a cap, noise, two terms; no cloning, splitting and resets."""

    def penalty(self) -> Tensor:
        """Terms on mean opacity and mean scale."""
        unit = UNIT_EXTENT / self.scene.extent
        scale = self.model.log_scales.exp().mean() * unit
        return OPACITY_WEIGHT * self.model.logits.sigmoid().mean() + SCALE_WEIGHT * scale

    def grow(self, number: int) -> None:
        """Relocate dead Gaussians and add new ones if it is due; then noise."""
        steps = self.training.steps
        if number % EVERY == 0 and GROW_FROM * steps < number < GROW_UNTIL * steps:
            self._relocate()
            self._add()
            self._forget()
        self._drift()

    @torch.no_grad()
    def _relocate(self) -> None:
        model = self.model
        opacities = model.logits.sigmoid()
        dead = (opacities <= DEAD).nonzero()[:, 0]
        alive = (opacities > DEAD).nonzero()[:, 0]
        if len(dead) and len(alive):
            rows = alive[self._drawn(opacities[alive], len(dead))]
            self._share_out(rows)
            for _, parameter in model.named_parameters():
                parameter[dead] = parameter[rows]

    @torch.no_grad()
    def _add(self) -> None:
        model, count = self.model, len(self.model.means)
        more = min(self.training.most, int((1 + GROWTH) * count)) - count
        if more > 0:
            rows = self._drawn(model.logits.sigmoid(), more)
            self._share_out(rows)
            keep = torch.ones(count, dtype=torch.bool, device=model.means.device)
            self.edit(keep, {name: p.detach()[rows] for name, p in model.named_parameters()})

    def _drawn(self, weights: Tensor, count: int) -> Tensor:
        """Rows drawn with a chance in proportion to weights, with replacement, int64 [count]."""
        drawn = torch.multinomial(weights.cpu(), count, replacement=True, generator=self.luck)
        return drawn.to(weights.device)

    def _share_out(self, rows: Tensor) -> None:
        """Give rows that are to be copied what each of their copies has, and no momentum."""
        model = self.model
        times = torch.bincount(rows, minlength=len(model.means)).clamp(max=MOST_COPIES - 1) + 1
        opacities, factors = relocated(model.logits.sigmoid(), times)
        copied = times > 1
        opacities = opacities.clamp(DEAD, 1 - 1e-6)
        model.logits.copy_(torch.where(copied, torch.logit(opacities), model.logits))
        logs = model.log_scales + factors.log()[:, None]
        model.log_scales.copy_(torch.where(copied[:, None], logs, model.log_scales))
        for _, parameter in model.named_parameters():
            state = self.optimizer.state.get(parameter, {})
            for moment in MOMENTS:
                if moment in state:
                    state[moment][copied] = 0

    @torch.no_grad()
    def _drift(self) -> None:
        """Noise on the means, the more the fainter a Gaussian is, shaped as the Gaussian is."""
        model = self.model
        rate = next(group["lr"] for group in self.optimizer.groups if group["name"] == "means")
        # In a unit in which the extent is UNIT_EXTENT; Σ has that unit squared.
        unit = UNIT_EXTENT / self.scene.extent
        loud = torch.sigmoid(STEEP * (1 - model.logits.sigmoid() - FAINT)) * NOISE * rate * unit**2
        heard = (loud > loud.new_tensor(1e-12)).nonzero()[:, 0]
        if not len(heard):
            return
        turns = rotation(model.quaternions[heard])
        noise = torch.randn(len(heard), 3, generator=self.luck).to(turns.device)
        scaled = (turns.mT @ noise[:, :, None])[:, :, 0] * (2 * model.log_scales[heard]).exp()
        model.means[heard] += (turns @ scaled[:, :, None])[:, :, 0] * loud[heard, None]
