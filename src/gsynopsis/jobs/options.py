"""Options of a run: how it is trained and measured, not what it becomes."""

from dataclasses import dataclass
from pathlib import Path

from gsynopsis.jobs.evaluate import Measures
from gsynopsis.training.loop import CHECKPOINT_SECONDS


@dataclass(frozen=True)
class RunOptions:
    """Machinery of a training; the keywords of `gs.train` by the same names.

    Attributes:
        device: `auto`, `cpu`, `cuda`, `webgpu` or `webgpu:NAME`; see `render.choose.take_device`.
        evaluate: Write the report of an evaluation beside the file.
        max_memory: Limit of memory, GiB, per process of torchrun: growth stops in time, and what
            cannot start is refused. None: no limit.
        checkpoint_seconds: Training time between checkpoints.
        photo_pixels: Pixels to render at the photos' own size in the evaluation.
        exposure: Evaluate also after the photos' exposure was taken out, if it was not solved.
        tensorboard: Write loss, held-out PSNR and images to RUN/tensorboard meanwhile.
        viewer_port: Port of a page on this machine that shows the training; 0 takes a free one.
            None: no page.
        cache: Folder for decoded photos, which stay there for other trainings. None: memory, or
            RUN/photos where they are too many, until the training is done.
    """

    device: str = "auto"
    evaluate: bool = True
    max_memory: float | None = None
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    photo_pixels: int = Measures.photo_pixels
    exposure: bool = False
    tensorboard: bool = False
    viewer_port: int | None = None
    cache: Path | None = None
