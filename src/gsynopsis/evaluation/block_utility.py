"""Block utility: mean improvement of images by each block of a file, for policies of clients.

An image is linear in colours. So the gradient of the error image of a level, taken through the
image of the full model, gives each Gaussian the error of the pixels that it covers, by the weight
with which it covers them. Summed over a block, this is the error that refining the block removes.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.container import Assembler
from gsynopsis.evaluation.evaluate import evenly
from gsynopsis.evaluation.protocols import eye_of
from gsynopsis.model.splats import FileModel, decoder_of
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.stream.paged import ancestors, boxes
from gsynopsis.stream.views import covered

Float64 = NDArray[np.float64]
VIEWS, WIDTH = 48, 240
"""Number and width, pixels, of the training views that utilities are measured in (ours: of 16, few
see a block of the background, and its utility is badly guessed)."""
CHANNELS = 3
"""Error images that go through one rendering."""
PRIOR = 0.3
"""Weight of the mean of all blocks in that of one, in units of a block's mean visibility."""


def cameras_of(scene: Scene, scale: float) -> list[Camera]:
    """Training views from which block utilities are measured, none larger than at a run's scale."""
    factor = scale * max(1.0, scene.camera(0, scale).width / WIDTH)
    return [scene.camera(view, factor) for view in evenly(scene.train, VIEWS)]


def measure_utilities(
    assembler: Assembler,
    cameras: Sequence[Camera],
    renderer: Renderer,
    tick: Callable[[int, int], None] | None = None,
) -> list[Float64]:
    """Mean squared error that each block takes off the part of the image where it is seen.

    Args:
        assembler: Holds all levels.
        cameras: Views to measure, at least one.
        renderer: Renders.
        tick: Called after each view with the views done and the views in all.

    Returns:
        Utilities as `utility_text` takes them.
    """
    levels = assembler.level_set()
    model = decoder_of(levels).to(renderer.device)
    count = len(levels.levels)
    finest = assembler.directories[count - 1]
    leaf_of: NDArray[np.int64] = np.zeros(levels.levels[-1].anchors, np.int64)
    for block in range(len(finest)):
        leaf_of[finest.rows_of(block)] = block
    leaves = torch.as_tensor(leaf_of, device=renderer.device)
    low, high = boxes(finest.records, assembler.index.header.voxel)
    errors, seen = np.zeros((count, len(finest))), np.zeros(len(finest))
    for done, camera in enumerate(cameras, start=1):
        errors[: count - 1] += _errors(model, camera, renderer, leaves, len(finest))
        seen += covered(low, high, eye_of(camera))
        if tick:
            tick(done, len(cameras))
    lineage = ancestors(assembler.directories)
    return [
        _densities(errors[level - 1] - errors[level], seen, lineage[level])
        for level in range(1, count)
    ]


def _densities(lower: Float64, seen: Float64, block_of: NDArray[np.int64]) -> Float64:
    """Error taken off per share of the image, by block, shrunk towards the mean of all."""
    count = int(block_of.max()) + 1
    taken = np.maximum(np.bincount(block_of, lower, count), 0.0)
    share = np.bincount(block_of, seen, count)
    mean = taken.sum() / max(float(share.sum()), 1e-12)
    weight = PRIOR * max(float(share.mean()), 1e-12)
    return np.minimum((taken + weight * mean) / (share + weight), 1.0)


def _errors(
    model: FileModel, camera: Camera, renderer: Renderer, leaves: Tensor, count: int
) -> Float64:
    """Squared error of each level but the finest, shared out among leaves, [levels - 1, R].

    The sum over leaves is the mean squared error of the image, as far as anything covers it.
    """
    black = torch.zeros(3, device=renderer.device)
    with torch.no_grad():
        full = model.decode_level(-1, camera)
        truth = renderer.render(full.gaussians, camera, black).image.clamp(0, 1)
        images = [
            renderer.render(model.decode(camera, level), camera, black).image.clamp(0, 1)
            for level in range(len(model.parts) - 1)
        ]
    errors = [(image - truth).square().mean(dim=2) / truth[..., 0].numel() for image in images]
    rows = leaves[full.slots // model.slots]
    found = np.zeros((len(errors), count))
    for first in range(0, len(errors), CHANNELS):
        group = errors[first : first + CHANNELS]
        weights = _weighed(renderer, full.gaussians, camera, group)
        sums = weights.new_zeros(count, CHANNELS).index_add_(0, rows, weights)
        found[first : first + len(group)] = sums.T[: len(group)].cpu().numpy()
    return found


def _weighed(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, images: Sequence[Tensor]
) -> Tensor:
    """Sum over pixels of each image times the weight of each Gaussian there, [G, 3]."""
    with torch.enable_grad():
        colors = torch.zeros_like(gaussians.colors).requires_grad_(True)
        leaf = replace(gaussians, colors=colors)
        rendered = renderer.render(leaf, camera, colors.new_zeros(3)).image
        loss = sum((rendered[..., k] * image).sum() for k, image in enumerate(images))
        assert isinstance(loss, Tensor)
        (weights,) = torch.autograd.grad(loss, colors)
    return weights
