"""Order in which a training sees its photos, and where in their pixels it samples them."""

from gsynopsis.training.regularize.jitter import draw_jitter, places
from gsynopsis.training.state import TrainState


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
