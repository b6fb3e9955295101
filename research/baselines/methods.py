"""Baselines by name: each makes nested levels of Gaussians from a scene (methods.md §6).

Levels hold 1/8, 1/4, 1/2 and all of the Gaussians, in an order that is the method's own; as they
are splats of our format, shared values are sent once and coded in the same way. Octree-GS has
anchors and levels of lattices. All render one image a step, `Task.steps` + `Task.level_steps` of
them.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.container.sizes import PAPER_DEFLATE_LEVEL, trained_text
from gsynopsis.model.build import model_to_levels
from gsynopsis.model.plain import PlainModel
from gsynopsis.model.splat_levels import splat_levels
from gsynopsis.records import TRAINED_NOTE, LevelSet, PlainGaussians
from gsynopsis.render.base import Renderer, blend_weights
from gsynopsis.scene.scene import Scene
from gsynopsis.training.losses import SSIM_WEIGHT, photometric_loss
from research.baselines import octree as lattices
from research.baselines.checkpoint_cache import TrainingCache
from research.baselines.gaussians import Training, from_points, photo, train_gaussians

Float64 = NDArray[np.float64]
SHARES = (1 / 8, 1 / 4, 1 / 2, 1.0)
"""Share of the Gaussians in each level, coarsest first (the paper's, for 3DGS)."""
PYRAMID = (8, 4, 2, 1)
"""Photos of LapisGS's layers are divided by this, beside the run's scale."""
Tick = Callable[[int, int], None]


@dataclass(frozen=True)
class Task:
    """Inputs of a baseline.

    Attributes:
        scene: Photos and cameras.
        renderer: With gradients.
        scale: Photos are divided by this.
        steps: Steps of the first training.
        level_steps: Steps of making its levels.
        seed: Seed of all random numbers.
        rates: Factor on 3DGS's learning rates.
        reset: True if opacities are reset while Gaussians grow.
        most: Gaussians at most.
        tick: Called with steps done and steps in all.
        kept: Cache of Gaussians trained by other tasks with the same settings; None: no cache.
    """

    scene: Scene
    renderer: Renderer
    scale: float
    steps: int
    level_steps: int
    seed: int = 0
    rates: float = 1.0
    reset: bool = True
    most: int = 1_000_000
    tick: Tick | None = None
    kept: TrainingCache | None = None

    def grown(self, steps: int) -> PlainGaussians:
        """3DGS after `steps` steps."""
        return self.kept.grown(steps, lambda: self._grow(steps)) if self.kept else self._grow(steps)

    def _grow(self, steps: int) -> PlainGaussians:
        training = Training(
            steps, self.scale, self.seed, True, self.reset, rates=self.rates, most=self.most
        )
        start = from_points(self.scene)
        return train_gaussians(start, self.scene, self.renderer, training, self.tick)


def gaussians(task: Task) -> LevelSet:
    """3DGS, one level."""
    found = task.grown(task.steps + task.level_steps)
    return nested(found, contributions(found, task), [len(found)])


def contribution(task: Task) -> LevelSet:
    """3DGS in the order of contribution to the training views, as it is (PRoGS, §6.2)."""
    found = task.grown(task.steps + task.level_steps)
    return nested(found, contributions(found, task), counts_of(len(found)))


def decimate(task: Task) -> LevelSet:
    """3DGS in the order of opacity times area, which needs no views: the floor (§6.2)."""
    found = task.grown(task.steps + task.level_steps)
    area = np.exp(found.log_scales.astype(np.float64).sum(axis=1) * (2 / 3))
    opacity = 1 / (1 + np.exp(-found.logits.astype(np.float64)))
    return nested(found, opacity * area, counts_of(len(found)))


def gode(task: Task) -> LevelSet:
    """3DGS, scored by gradients level after level; then a random level each step (GoDe, §6.3)."""
    found = task.grown(task.steps)
    counts = counts_of(len(found))
    found = sorted_by(found, gradients(found, counts, task))

    def level(chance: np.random.Generator, _: int) -> int:
        return counts[int(chance.integers(len(counts)))]

    return ordered(fine_tuned(found, task, drawn=level), counts)


def any_prefix(task: Task) -> LevelSet:
    """3DGS in the order of contribution; then a random prefix each step (Matryoshka, §6.4)."""
    found = task.grown(task.steps)
    found = sorted_by(found, contributions(found, task))
    counts = counts_of(len(found))

    def cut(chance: np.random.Generator, count: int) -> int:
        return max(1, round(count * float(np.exp(chance.uniform(np.log(SHARES[0]), 0)))))

    return ordered(fine_tuned(found, task, drawn=cut), counts)


def layers(task: Task) -> LevelSet:
    """3DGS cut into bands by contribution, each trained upon those before it (L3GS, §6.5)."""
    found = task.grown(task.steps)
    found = sorted_by(found, contributions(found, task))
    counts = counts_of(len(found))
    for first, end in zip([0, *counts[:-1]], counts, strict=True):
        training = Training(
            max(1, task.level_steps // len(counts)),
            task.scale,
            task.seed + end,
            frozen=first,
            drawn=lambda _, count, end=end: min(end, count),
            rates=task.rates,
        )
        found = train_gaussians(found, task.scene, task.renderer, training, task.tick)
    return ordered(found, counts)


def lapis(task: Task) -> LevelSet:
    """A layer a size of the photos, each grown upon the frozen ones before it (LapisGS, §6.6).

    Opacities stay frozen too (its mode *freeze*), so that levels nest; λ_dssim 0.2.
    """
    found, counts = None, list[int]()
    share = (task.steps + task.level_steps) // len(PYRAMID)
    for divided in PYRAMID:
        fresh = from_points(task.scene)
        frozen = len(found) if found else 0
        start = joined(found, fresh) if found else fresh
        training = Training(
            max(1, share),
            task.scale * divided,
            task.seed + divided,
            True,
            task.reset,
            frozen,
            rates=task.rates,
            most=task.most,
        )
        found = train_gaussians(start, task.scene, task.renderer, training, task.tick)
        counts.append(len(found))
    assert found is not None
    return ordered(found, counts)


def octree(task: Task) -> LevelSet:
    """Anchors on lattices of several sizes, drawn by their distance (Octree-GS, §6.7)."""
    steps = task.steps + task.level_steps
    training = lattices.OctreeTraining(
        task.scene, task.renderer, task.scale, steps, task.seed, task.most
    )
    model = training.run(task.tick)
    lattices.with_levels(model, len(SHARES))
    return model_to_levels(model, {lattices.NOTE: lattices.gate_text(model.gate)})


METHODS: Mapping[str, Callable[[Task], LevelSet]] = {
    "gaussians": gaussians,
    "contribution": contribution,
    "decimate": decimate,
    "gode": gode,
    "prefix": any_prefix,
    "layers": layers,
    "lapis": lapis,
    "octree": octree,
}


def counts_of(total: int) -> list[int]:
    """Gaussians of each level."""
    return [max(1, round(total * share)) for share in SHARES]


def contributions(found: PlainGaussians, task: Task) -> Float64:
    """Blend weights over all training views, in pixels [G] (§6.2)."""
    model, sums = _model(found, task), torch.zeros(len(found), dtype=torch.float64)
    for view in task.scene.train:
        camera = task.scene.camera(view, task.scale)
        with torch.no_grad():
            decoded = model.decode(camera)
        sums += blend_weights(task.renderer, decoded, camera).double().cpu()
    return sums.numpy()


def gradients(found: PlainGaussians, counts: Sequence[int], task: Task) -> Float64:
    """Score of Gaussians [G]: from the finest level down, those with least gradient are removed.

    The gradient is that of the loss by a Gaussian's colour, its norm summed over training views, in
    renders of the remaining Gaussians (GoDe computes scores again in each round).
    """
    worth, left = np.zeros(len(found)), np.arange(len(found))
    for round_, count in enumerate([*counts[-2::-1], 0]):
        model = _model(taken(found, left), task)
        sums = torch.zeros(len(left), dtype=torch.float64)
        for view in task.scene.train:
            camera = task.scene.camera(view, task.scale)
            decoded = model.decode(camera)
            black = torch.zeros(3, device=model.means.device)
            image = task.renderer.render(decoded, camera, black).image
            truth = photo(task.scene, view, task.scale, model.means.device)
            loss = photometric_loss(image, truth, SSIM_WEIGHT)
            (grad,) = torch.autograd.grad(loss, decoded.colors)
            sums += grad.norm(dim=1).double().cpu()
        scores = sums.numpy()
        share = scores / max(float(scores.max()), 1e-300)
        order = np.argsort(-scores, kind="stable")
        worth[left] = round_ + share
        left = left[np.sort(order[:count])]
    return worth


def fine_tuned(
    found: PlainGaussians, task: Task, drawn: Callable[[np.random.Generator, int], int]
) -> PlainGaussians:
    """Trained on, each step a prefix of the rows."""
    training = Training(
        max(1, task.level_steps), task.scale, task.seed + 1, drawn=drawn, rates=task.rates
    )
    return train_gaussians(found, task.scene, task.renderer, training, task.tick)


def ordered(found: PlainGaussians, counts: Sequence[int]) -> LevelSet:
    """Nested levels of Gaussians whose rows are in order."""
    level = np.searchsorted(counts, np.arange(len(found)), side="right")
    return nested(found, (len(counts) - level).astype(np.float64), counts)


def nested(found: PlainGaussians, worth: Float64, counts: Sequence[int]) -> LevelSet:
    """Levels of the rows with most worth, with a note of their sizes before rounding.

    That is 59 float32 a Gaussian with harmonics of degree 3: 3DGS's rows without the normals,
    which nothing fills.
    """
    order, sizes = np.argsort(-worth, kind="stable"), list[list[int]]()
    for first, end in zip([0, *counts[:-1]], counts, strict=True):
        part = taken(found, order[first:end])
        values = [column.reshape(len(part), -1) for column in vars(part).values()]
        rows = np.concatenate(values, axis=1).astype("<f4").tobytes()
        sizes.append([len(rows), len(zlib.compress(rows, PAPER_DEFLATE_LEVEL)), len(rows)])
    return splat_levels(found, worth, counts, {TRAINED_NOTE: trained_text(sizes)})


def sorted_by(found: PlainGaussians, worth: Float64) -> PlainGaussians:
    """The most worth first."""
    return taken(found, np.argsort(-worth, kind="stable"))


def taken(found: PlainGaussians, rows: NDArray[np.int64]) -> PlainGaussians:
    """Some rows."""
    return PlainGaussians(*(values[rows] for values in vars(found).values()))


def joined(first: PlainGaussians, second: PlainGaussians) -> PlainGaussians:
    """Rows of one, then those of the other."""
    pairs = zip(vars(first).values(), vars(second).values(), strict=True)
    return PlainGaussians(*(np.concatenate(pair) for pair in pairs))


def _model(found: PlainGaussians, task: Task) -> PlainModel:
    return PlainModel(found, antialiased=False).to(task.renderer.device)
