"""Order in which a training sees its photos, where in their pixels, and how much reduced."""

import math

from gsynopsis.training.regularize.jitter import draw_jitter, places
from gsynopsis.training.state import TrainState

LEAST_SIDE = 64
"""Shorter side of the largest photo, pixels, below which pictures are not reduced further (ours:
with 66 pixels a training was ahead, with 33 behind)."""


def binning_of(state: TrainState, progress: float) -> int:
    """Side of the squares of pixels whose means are compared, at this share of all steps."""
    context = state.context
    halvings = sum(progress < share for share in context.config.train.reduced_until)
    if not halvings:
        return 1
    cameras = [context.scene.camera(view, context.config.scale) for view in context.scene.train]
    side = max(min(camera.width, camera.height) for camera in cameras)
    return 2 ** min(halvings, max(0, int(math.log2(side / LEAST_SIDE))))


def next_views(state: TrainState) -> list[int]:
    """The `train.batch` views of a step; draws their jitter. Alike in every process."""
    if state.subpixels > 1:
        state.jitter = draw_jitter(state.rng, state.subpixels)
    return [next_view(state) for _ in range(state.context.config.train.batch)]


def next_view(state: TrainState) -> int:
    """A training view, without replacement until all were seen (methods.md §1.7)."""
    context, progress = state.context, state.progress
    train = context.scene.train
    if not progress.order:
        progress.order = [train[i] for i in state.rng.permutation(len(train))]
    view = progress.order.pop()
    if progress.order:
        # Decode, or upload, the photo of the next step while this one computes.
        loader = context.scene if state.photos is None else state.photos
        loader.expect(progress.order[-1], context.config.scale, places(state.subpixels))
    return view
