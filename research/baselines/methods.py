"""Baselines by name: each makes nested levels of Gaussians from a scene (methods.md §6).

Levels hold 1/8, 1/4, 1/2 and all of the Gaussians, in an order that is the method's own; as they
are splats of our format, shared values are sent once and coded in the same way. Octree-GS has
anchors and levels of lattices. All render `Task.steps` + `Task.level_steps` images.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.container.sizes import PAPER_DEFLATE_LEVEL, trained_text
from gsynopsis.evaluation.protocols import Decoder
from gsynopsis.model.build import model_to_levels
from gsynopsis.model.plain import PlainModel
from gsynopsis.model.splat_levels import Steps, row_order, splat_levels
from gsynopsis.model.splats import SplatModel, SplatPart, decoder_of
from gsynopsis.model.training_focals import focals_text
from gsynopsis.records import FOCALS_NOTE, TRAINED_NOTE, LevelSet, PlainGaussians
from gsynopsis.render.base import Renderer, TrainingFocals
from gsynopsis.render.measures import blend_weights, removal_effects
from gsynopsis.scene.scene import Scene
from gsynopsis.training.losses import SSIM_WEIGHT
from gsynopsis.training.view_step import photometric_loss
from research.baselines import octree as lattices
from research.baselines.checkpoint_cache import TrainingCache
from research.baselines.gaussians import (
    DEGREE,
    Training,
    from_points,
    photo,
    train_gaussians,
)
from research.baselines.level_opacities import LevelOpacities, opacity_columns
from research.baselines.mcmc import train_mcmc
from research.baselines.ordered_coding import View, ordered_steps, sensitivity_of

Float64 = NDArray[np.float64]
SHARES = (1 / 8, 1 / 4, 1 / 2, 1.0)
"""Share of the Gaussians in each level, coarsest first (the paper's, for 3DGS)."""
PYRAMID = (8, 4, 2, 1)
"""Photos of LapisGS's layers are divided by this, beside the run's scale."""
LAPIS_SSIM_WEIGHT = 0.8
"""λ_SSIM of LapisGS."""
PRUNE_SHARE = 0.0036
"""Share of all removal effect that MCMC's pruning may lose, as the presets of ours (§2.3)."""
Tick = Callable[[int, int], None]


@dataclass(frozen=True)
class Task:
    """Inputs of a baseline.

    Attributes:
        scene: Photos and cameras.
        renderer: With gradients.
        scale: Photos are divided by this.
        steps: Images of our full training.
        level_steps: Images of the training of our levels.
        seed: Seed of all random numbers.
        rates: Factor on 3DGS's learning rates.
        reset: True if opacities are reset while Gaussians grow.
        degree: Of the spherical harmonics.
        most: Gaussians at most, or anchors.
        subpixels: Photos are sampled at so many places of a pixel along each axis.
        coding_loss: Loss of rounding that is ordered, dB; 0: fixed steps.
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
    degree: int = DEGREE
    most: int = 1_000_000
    subpixels: int = 1
    coding_loss: float = 0.0
    tick: Tick | None = None
    kept: TrainingCache | None = None

    @property
    def images(self) -> int:
        """Images that the whole training renders."""
        return self.steps + self.level_steps

    @property
    def base(self) -> int:
        """Images of the training that levels are made from: half of all."""
        return max(1, self.images // 2)

    def grown(self, steps: int) -> PlainGaussians:
        """3DGS after `steps` steps."""
        return self._kept(f"{steps}", lambda: self._grow(steps))

    def sampled(self, steps: int) -> PlainGaussians:
        """3DGS-MCMC after `steps` steps."""
        return self._kept(f"mcmc-{steps}", lambda: self._sample(steps))

    def training(self, steps: int, seed: int = 0) -> Training:
        """A training of `steps` steps; nothing grows."""
        return Training(
            max(1, steps),
            self.scale,
            self.seed + seed,
            reset=self.reset,
            rates=self.rates,
            most=self.most,
            subpixels=self.subpixels,
        )

    def _kept(self, name: str, train: Callable[[], PlainGaussians]) -> PlainGaussians:
        return self.kept.grown(name, train) if self.kept else train()

    def _grow(self, steps: int) -> PlainGaussians:
        training = replace(self.training(steps), grow=True)
        start = from_points(self.scene, self.degree)
        return train_gaussians(start, self.scene, self.renderer, training, self.tick)

    def _sample(self, steps: int) -> PlainGaussians:
        training = replace(self.training(steps), grow=True)
        return train_mcmc(self.scene, self.renderer, training, self.degree, self.tick)


@dataclass(frozen=True)
class Rival:
    """A trained baseline.

    Attributes:
        levels: For the file.
        uncoded: Decoder of the levels before any rounding.
        decoder: Gives the decoder of the levels that were read from the file.
        extra: Bytes that each level takes beside the file, coarsest first; none: nothing does.
    """

    levels: LevelSet
    uncoded: Decoder
    decoder: Callable[[LevelSet], lattices.FileModel] = decoder_of
    extra: tuple[int, ...] = ()


def gaussians(task: Task) -> Rival:
    """3DGS, one level."""
    found = task.grown(task.images)
    return nested(found, contributions(found, task), [len(found)], task)


def contribution(task: Task) -> Rival:
    """3DGS in the order of contribution to the training views, as it is (PRoGS, §6.2)."""
    found = task.grown(task.images)
    return nested(found, contributions(found, task), counts_of(len(found)), task)


def decimate(task: Task) -> Rival:
    """3DGS in the order of opacity times area, which needs no views: the floor (§6.2)."""
    found = task.grown(task.images)
    area = np.exp(found.log_scales.astype(np.float64).sum(axis=1) * (2 / 3))
    opacity = 1 / (1 + np.exp(-found.logits.astype(np.float64)))
    return nested(found, opacity * area, counts_of(len(found)), task)


def gode(task: Task) -> Rival:
    """3DGS, scored by gradients level after level; then a random level each step (GoDe, §6.3)."""
    found = task.grown(task.base)
    counts = counts_of(len(found))
    found = sorted_by(found, gradients(found, counts, task))
    return ordered(any_level(found, counts, task), counts, task)


def any_prefix(task: Task) -> Rival:
    """3DGS in the order of contribution; then a random prefix and all of it each step (§6.4)."""
    found = task.grown(task.base)
    found = sorted_by(found, contributions(found, task))
    counts = counts_of(len(found))

    def cut(chance: np.random.Generator, count: int) -> tuple[int, ...]:
        shown = max(1, round(count * float(np.exp(chance.uniform(np.log(SHARES[0]), 0)))))
        return shown, count

    steps = (task.images - task.base) // 2  # of two images each
    training = replace(task.training(steps, 1), drawn=cut)
    tuned = train_gaussians(found, task.scene, task.renderer, training, task.tick)
    return ordered(tuned, counts, task)


def layers(task: Task) -> Rival:
    """3DGS cut into bands by contribution, each trained upon those before it (L3GS, §6.5)."""
    found = task.grown(task.base)
    found = sorted_by(found, contributions(found, task))
    counts = counts_of(len(found))
    for first, end in zip([0, *counts[:-1]], counts, strict=True):
        training = replace(
            task.training((task.images - task.base) // len(counts), end),
            frozen=first,
            drawn=lambda _, count, end=end: (min(end, count),),
        )
        found = train_gaussians(found, task.scene, task.renderer, training, task.tick)
    return ordered(found, counts, task)


def lapis(task: Task) -> Rival:
    """A layer a size of the photos, each grown upon those before it (LapisGS, §6.6).

    Of the layers before, opacities alone learn on; each level has its own.
    """
    found, counts, logits = None, list[int](), list[NDArray[np.float32]]()
    for divided in PYRAMID:
        fresh = from_points(task.scene, task.degree)
        frozen = len(found) if found else 0
        start = joined(found, fresh) if found else fresh
        training = replace(
            task.training(task.images // len(PYRAMID), divided),
            scale=task.scale * divided,
            grow=True,
            frozen=frozen,
            opacities=True,
            ssim_weight=LAPIS_SSIM_WEIGHT,
        )
        found = train_gaussians(start, task.scene, task.renderer, training, task.tick)
        counts.append(len(found))
        logits.append(found.logits)
    assert found is not None
    first = [0, *counts[:-1]]
    sent = [own[start:] for own, start in zip(logits, first, strict=True)]
    found = replace(found, logits=np.concatenate(sent))
    return ordered(found, counts, task, PYRAMID, logits)


def mcmc(task: Task) -> Rival:
    """3DGS-MCMC, pruned and ordered by removal effect; then a random level each step (§6.8)."""
    found = task.sampled(task.base)
    effects = effects_of(found, task)
    found = sorted_by(found, effects)
    lost = np.cumsum(np.sort(effects))
    found = taken(found, np.arange(max(1, int((lost > PRUNE_SHARE * lost[-1]).sum()))))
    counts = counts_of(len(found))
    return ordered(any_level(found, counts, task), counts, task)


def octree(task: Task) -> Rival:
    """Anchors on lattices of several sizes, drawn by their distance (Octree-GS, §6.7)."""
    training = lattices.OctreeTraining(task.scene, task.renderer, task.training(task.images))
    model = training.run(task.tick)
    lattices.with_levels(model, len(SHARES))
    count = len(model.parts)
    meta = {
        lattices.NOTE: lattices.gate_text(model.gate),
        FOCALS_NOTE: focals_text([focals_at(task, 1)] * count),
    }
    levels = model_to_levels(model, meta)
    return Rival(levels, model, lambda read: lattices.gated(decoder_of(read), read.meta))


METHODS: Mapping[str, Callable[[Task], Rival]] = {
    "gaussians": gaussians,
    "contribution": contribution,
    "decimate": decimate,
    "gode": gode,
    "prefix": any_prefix,
    "layers": layers,
    "lapis": lapis,
    "mcmc": mcmc,
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


def effects_of(found: PlainGaussians, task: Task) -> Float64:
    """Removal effects over all training views [G] (§2.2)."""
    model, sums = _model(found, task), torch.zeros(len(found), dtype=torch.float64)
    black = torch.zeros(3, device=task.renderer.device)
    for view in task.scene.train:
        camera = task.scene.camera(view, task.scale)
        chance = torch.Generator().manual_seed(view)
        with torch.no_grad():
            decoded = model.decode(camera)
        effects = removal_effects(task.renderer, decoded, camera, black, chance)
        sums += effects.double().cpu()
    return sums.numpy()


def any_level(found: PlainGaussians, counts: Sequence[int], task: Task) -> PlainGaussians:
    """Trained on with the images that are left, each of a random level (GoDe)."""

    def level(chance: np.random.Generator, _: int) -> tuple[int, ...]:
        return (counts[int(chance.integers(len(counts)))],)

    training = replace(task.training(task.images - task.base, 1), drawn=level)
    return train_gaussians(found, task.scene, task.renderer, training, task.tick)


def focals_at(task: Task, divided: float) -> TrainingFocals:
    """Shortest and longest focal length of the training photos, divided further."""
    scale = task.scale * divided
    lengths = [task.scene.camera(view, scale).focal_length for view in task.scene.train]
    return min(lengths), max(lengths)


def ordered(
    found: PlainGaussians,
    counts: Sequence[int],
    task: Task,
    divided: Sequence[float] = (),
    logits: Sequence[NDArray[np.float32]] = (),
) -> Rival:
    """Nested levels of Gaussians whose rows are in order; more as in `nested`."""
    level = np.searchsorted(counts, np.arange(len(found)), side="right")
    worth = (len(counts) - level).astype(np.float64)
    return nested(found, worth, counts, task, divided, logits)


def nested(
    found: PlainGaussians,
    worth: Float64,
    counts: Sequence[int],
    task: Task,
    divided: Sequence[float] = (),
    logits: Sequence[NDArray[np.float32]] = (),
) -> Rival:
    """Levels of the rows with most worth, with notes of how large their photos and values were.

    Values are 59 float32 a Gaussian with harmonics of degree 3: 3DGS's rows without the normals,
    which nothing fills.

    Args:
        found: G of them.
        worth: The most come first [G].
        counts: Gaussians of each level.
        task: Scene, scale, order of rounding.
        divided: Photos of each level's training were divided by this further; empty: by 1.
        logits: Opacities of each level's Gaussians before the logistic function, in the order of
            worth; empty: all levels have those of `found`.
    """
    found, worth = sorted_by(found, worth), -np.sort(-worth, kind="stable")
    divided = divided or [1.0] * len(counts)
    sizes = list[list[int]]()
    for first, end in zip([0, *counts[:-1]], counts, strict=True):
        part = taken(found, np.arange(first, end))
        values = [column.reshape(len(part), -1) for column in vars(part).values()]
        rows = np.concatenate(values, axis=1).astype("<f4").tobytes()
        sizes.append([len(rows), len(zlib.compress(rows, PAPER_DEFLATE_LEVEL)), len(rows)])
    focals = [focals_at(task, by) for by in divided]
    meta = {TRAINED_NOTE: trained_text(sizes), FOCALS_NOTE: focals_text(focals)}
    own = [found.logits[:count] for count in counts] if not logits else list(logits)
    steps, weights = Steps(), None
    if task.coding_loss:
        shown = [
            replace(taken(found, np.arange(count)), logits=opacities)
            for count, opacities in zip(counts, own, strict=True)
        ]
        sensitivity = sensitivity_of(shown, lambda k: _views(task, divided[k]), task.renderer)
        steps = ordered_steps(found, worth, counts, sensitivity, task.coding_loss)
        weights = sensitivity.harmonics_each
    levels = splat_levels(found, worth, counts, meta, steps, weights=weights)
    parts = [
        SplatPart((torch.arange(len(found)) < count)[:, None], torch.ones(3), own_focals)
        for count, own_focals in zip(counts, focals, strict=True)
    ]
    if not logits:
        return Rival(levels, SplatModel(found, parts))
    order = row_order(found, worth, counts, steps)
    columns, extra = opacity_columns(own, order, steps.logit)
    return Rival(
        levels,
        LevelOpacities.of(SplatModel(found, parts), own),
        lambda read: LevelOpacities.of(decoder_of(read), columns),
        extra,
    )


def _views(task: Task, divided: float) -> list[View]:
    scale, device = task.scale * divided, task.renderer.device
    return [
        View(task.scene.camera(view, scale), photo(task.scene, view, scale, device))
        for view in task.scene.train
    ]


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
