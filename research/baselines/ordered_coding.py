"""Rounding steps of splats by what images lose, as `coding_loss` orders them for anchors (§6).

Letters: G Gaussians, C coefficients of the harmonics.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import log

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.model.harmonics import harmonic_colors
from gsynopsis.model.splat_levels import Steps, code_harmonics, row_order, small_scale, spans_of
from gsynopsis.model.splats import rotations_of, ycocg_of
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.render.measures import random_signs
from gsynopsis.scene.camera import Camera
from gsynopsis.training.levels.sensitivity import BEST_ERROR, DECIBELS, VIEWS

KINDS = {"position": 3, "log_scale": 3, "rotation": 3, "logit": 1, "luma": 1, "chroma": 2}
"""Rounded values of a Gaussian, by the names of their steps."""
HARMONICS = "harmonics"
COARSEST = {
    "position": 2.0,
    "log_scale": 0.5,
    "rotation": 0.125,
    "logit": 1.0,
    "luma": 0.25,
    "chroma": 0.25,
}
"""Longest steps: beyond them an image is no longer linear in what rounding does."""
CODINGS = tuple(product((1, 2, 4, 8), (1 / 10, 1 / 4)))
"""Codes of harmonics, and bytes of codebooks in shares of the rows' bytes, that are tried."""
BYTE = 8
"""Bits of a value of a codebook."""
FRACTIONS = (1.0, 1.25, 1.5, 1.75)
"""Steps are these times a power of two, which the coding finds again."""


@dataclass(frozen=True)
class View:
    """A training view at the size that a level is trained for.

    Attributes:
        camera: Of the view.
        photo: [H, W, 3] in [0, 1].
    """

    camera: Camera
    photo: Tensor


@dataclass(frozen=True)
class Sensitivity:
    """Decibels of the images by the squared error of each value; the most of any level.

    Attributes:
        kinds: By the names of `KINDS`, float64 [G, n].
        harmonics: Of the coefficients beyond the first, float64 [G, C - 1, 3].
    """

    kinds: Mapping[str, Tensor]
    harmonics: Tensor

    @property
    def harmonics_each(self) -> NDArray[np.float64]:
        """Decibels by the squared error of a value of each Gaussian's harmonics, on average [G]."""
        values = self.harmonics.numpy().reshape(len(self.harmonics), -1)
        return values.sum(axis=1) / max(values.shape[1], 1)

    def sums(self) -> dict[str, float]:
        """Sums over all Gaussians, by kind."""
        return {name: float(values.sum()) for name, values in self.kinds.items()}


def sensitivity_of(
    levels: Sequence[PlainGaussians], views: Callable[[int], Sequence[View]], renderer: Renderer
) -> Sensitivity:
    """The sensitivity of Gaussians in nested levels.

    Args:
        levels: Of each level the Gaussians, coarsest first; each begins with the one before.
        views: Training views of each level.
        renderer: With gradients.
    """
    total: dict[str, Tensor] = {}
    for number, found in enumerate(levels):
        shown = views(number)[:: -(-len(views(number)) // VIEWS)]
        sums: dict[str, Tensor] = {}
        for index, view in enumerate(shown):
            for name, gradient in _gradients(found, view, renderer, index).items():
                square = gradient.double().square() / len(shown)
                sums[name] = sums[name] + square if name in sums else square
        for name, values in sums.items():
            if name in total:
                values[: len(total[name])] = values[: len(total[name])].maximum(total[name])
            total[name] = values.cpu()
    return Sensitivity({name: total[name] for name in KINDS}, total[HARMONICS])


def _gradients(
    found: PlainGaussians, view: View, renderer: Renderer, seed: int
) -> dict[str, Tensor]:
    """Gradients by kind whose squares are the loss of one image in decibels, on average."""
    device = renderer.device

    def leaf(values: NDArray[np.floating]) -> Tensor:
        return torch.tensor(values, dtype=torch.float32, device=device, requires_grad=True)

    means, logs, logits = leaf(found.means), leaf(found.log_scales), leaf(found.logits)
    turn, color = leaf(rotations_of(found.quaternions)), ycocg_of(found.sh[:, 0])
    luma, chroma, rest = leaf(color[:, :1]), leaf(color[:, 1:]), leaf(found.sh[:, 1:])
    square = turn.square().sum(dim=1, keepdim=True)
    quaternions = torch.cat([1 - square, 2 * turn], dim=1) / (1 + square)
    y, orange, green = luma[:, 0], chroma[:, 0], chroma[:, 1]
    base = torch.stack([y - green + orange, y + green, y - green - orange], dim=1)
    eye = torch.as_tensor(view.camera.position, dtype=torch.float32, device=device)
    colors = harmonic_colors(torch.cat([base[:, None], rest], dim=1), means.detach() - eye)
    gaussians = Gaussians(means, quaternions, logs.exp(), logits.sigmoid(), colors)
    image = renderer.render(gaussians, view.camera, torch.zeros(3, device=device)).image
    error = max(float((image.detach() - view.photo).square().mean()), BEST_ERROR)
    signs = random_signs(image, torch.Generator().manual_seed(seed))
    weights = signs * (DECIBELS / (error * image.numel())) ** 0.5
    leaves = {
        "position": means,
        "log_scale": logs,
        "rotation": turn,
        "logit": logits,
        "luma": luma,
        "chroma": chroma,
        HARMONICS: rest,
    }
    found_of = torch.autograd.grad(
        (image * weights).sum(), list(leaves.values()), allow_unused=True
    )
    return {
        name: torch.zeros_like(value) if gradient is None else gradient.reshape(value.shape)
        for (name, value), gradient in zip(leaves.items(), found_of, strict=True)
    }


def steps_for(sums: Mapping[str, float], loss: float) -> dict[str, float]:
    """The longest steps with which images lose `loss` dB, shared by the number of values.

    A step s leaves errors of variance s²/12. That share takes the fewest bytes: the last byte of
    each kind then brings as much.

    Args:
        sums: Decibels by squared error of each kind, over all Gaussians.
        loss: Ordered, dB.
    """
    values = sum(KINDS.values())
    return {
        name: (12 * loss * count / values / max(sums[name], 1e-30)) ** 0.5
        for name, count in KINDS.items()
    }


def rounded_down(step: float) -> float:
    """The largest of `FRACTIONS` times a power of two that is not above `step`."""
    power = 2.0 ** np.floor(np.log2(step))
    return float(max(f * power for f in FRACTIONS if f * power <= step))


def ordered_steps(
    found: PlainGaussians,
    worth: NDArray[np.float64],
    counts: Sequence[int],
    sensitivity: Sensitivity,
    loss: float,
) -> Steps:
    """Steps with which the images of splats lose `loss` dB, in the fewest bits.

    The harmonics are coded in all ways of `CODINGS`; the one is taken that loses and needs least,
    where a decibel is worth the bits that scalar values pay for it at half of the order. These get
    what is left of the order, at least half of it.

    Args:
        found: In the order of `sensitivity`.
        worth: As of `splat_levels`.
        counts: Gaussians of each level.
        sensitivity: Of `found`.
        loss: Ordered, dB.
    """
    # A step half as long is a bit more for each value and a quarter of the loss.
    bits_each = sum(KINDS.values()) * len(found) / (2 * log(2) * loss / 2)
    best = min(
        coded_harmonics(found, worth, counts, sensitivity, 1 / bits_each),
        key=lambda coded: coded.bits + bits_each * coded.lost,
    )
    longest = steps_for(sensitivity.sums(), max(loss - best.lost, loss / 2))
    longest["position"] /= small_scale(found)
    steps = {name: rounded_down(min(step, COARSEST[name])) for name, step in longest.items()}
    return replace(best.steps, **steps)


@dataclass(frozen=True)
class CodedHarmonics:
    """One way to code harmonics.

    Attributes:
        steps: Of them `stages`, `books` and `price`.
        bits: Of codes, as an entropy coder needs, and codebooks.
        lost: Decibels that images lose.
    """

    steps: Steps
    bits: float
    lost: float


def coded_harmonics(
    found: PlainGaussians,
    worth: NDArray[np.float64],
    counts: Sequence[int],
    sensitivity: Sensitivity,
    price: float,
) -> list[CodedHarmonics]:
    """The harmonics in all ways of `CODINGS`; `price` is that of a bit, dB, else as above."""
    if found.degree == 0:
        return [CodedHarmonics(Steps(stages=1), 0.0, 0.0)]
    order, spans = row_order(found, worth, counts, Steps()), spans_of(counts)
    wanted = found.sh[order, 1:].reshape(len(order), -1).astype(np.float64)
    each = sensitivity.harmonics.numpy()[order].reshape(wanted.shape)
    weights = sensitivity.harmonics_each
    squares = np.square(wanted).sum(axis=1)
    mean_square = float((weights[order] * squares).mean())
    ways = list[CodedHarmonics]()
    for stages, books in CODINGS:
        steps = Steps(stages=stages, books=books, price=price / max(mean_square, 1e-300))
        codes, made = code_harmonics(found, weights, order, spans, steps)
        bits = lost = 0.0
        for (start, end), book in zip(spans, made, strict=True):
            rows = slice(start, end)
            parts = zip(np.split(book, stages, axis=1), codes[rows].T, strict=True)
            shown = sum((part[column] for part, column in parts), np.zeros_like(wanted[rows]))
            lost += float((each[rows] * np.square(shown - wanted[rows])).sum())
            bits += BYTE * book.size + sum(entropy_of(column) for column in codes[rows].T)
        ways.append(CodedHarmonics(steps, bits, lost))
    return ways


def entropy_of(column: NDArray[np.uint8]) -> float:
    """Bits that an entropy coder needs for all values of a column."""
    often = np.bincount(column)
    often = often[often > 0]
    return float((often * np.log2(len(column) / often)).sum())
