"""`gsynopsis train`: a scene in, one progressive file out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gsynopsis.cli.bounds import with_training
from gsynopsis.cli.defaults import said
from gsynopsis.cli.flags import Overrides, asked_of
from gsynopsis.cli.report import print_plan, print_report
from gsynopsis.config import PresetName, Split
from gsynopsis.scene.masks import MaskUse


@dataclass(frozen=True)
class Train:
    """Train a scene into RUN/scene.gsyn; repeat the same command to go on after a stop.

    Attributes:
        scene: Folder with images/ and sparse/0/ (COLMAP), or with transforms.json; of photos alone
            or a video poses are estimated first, into RUN/scene.
        out: Folder of the run: checkpoints, scene.gsyn, metrics, pictures.
        quality: How long to train: a quarter of the steps of `standard`, twice or five times as
            many; what it takes is said first. `paper` is the paper's model and values.
        scale: Divide the photos' width and height by this: the training resolution.
        split: Rule that chooses the held-out views.
        images: Folder of photos in the scene's, as `images_4`; sizes may differ from the cameras'.
        max_width: Divide wider photos so that they have this many pixels across (1600 in the
            literature); 0: never.
        masks: What masks/NAME.png are for: pixels outside do not count (loss), are trained to be
            empty so that no background is in the file (empty), or nothing (off); alpha: as loss,
            with the alpha channels of the photos as masks.
        overrides: What to change of the preset; what is given always wins.
        max_memory: Memory for training, GiB, of the GPU if one trains, per process of torchrun:
            growth stops in time, and what cannot start is refused.
        cache: Folder that keeps decoded photos for other trainings too; else they are in memory,
            or in RUN/photos where they take more than 1 GiB, until training is done.
        checkpoint_seconds: Seconds between checkpoints: at most this is lost on a power cut.
        blocks: Divide a large scene into so many blocks of space, each trained on its own after the
            whole, and join them into one file; 0: one training.
        jobs: Blocks at once, each a process that shares cores and `max_memory` with the others.
        ray: Train the blocks on the Ray cluster of this address instead (extra `ray`), or `local`.
        viewer: Serve a page that shows the training while it runs.
        viewer_port: Port of that page, on this machine only; 0 takes a free one.
        tensorboard: Write loss, held-out PSNR and pictures to RUN/tensorboard while it runs.
        device: What trains: `auto` (CUDA, else the CPU), `cpu`, `cuda`, `webgpu` (any GPU, tested
            before), or `webgpu:NAME` for the adapter whose name holds NAME.
        evaluate: Write the report of an evaluation on the held-out views beside the file.
        json: Print metrics.json instead of the table.
        quiet: Say nothing on the way.
    """

    scene: Positional[Path]
    out: Path
    quality: Annotated[PresetName, arg(aliases=["--preset"])] = "standard"
    scale: float = 1.0
    split: Split = "every8"
    images: str = "images"
    max_width: int = 0
    masks: Annotated[MaskUse | None, said("loss, where there are masks")] = None
    overrides: Annotated[Overrides, arg(name="")] = field(default_factory=Overrides)
    max_memory: Annotated[float | None, said("no limit")] = None
    cache: Annotated[Path | None, said("memory, or RUN/photos")] = None
    checkpoint_seconds: float = 120.0
    blocks: int = 0
    jobs: int = 1
    ray: Annotated[str | None, said("none, this machine")] = None
    viewer: bool = False
    viewer_port: int = 8000
    tensorboard: bool = False
    device: str = "auto"
    evaluate: bool = True
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Train, pack, evaluate, print."""
        asked = asked_of(self.overrides)
        with with_training():
            from gsynopsis.jobs.train import train
        run = train(
            self.scene,
            self.quality,
            self.out,
            settings=asked,
            scale=self.scale,
            max_width=self.max_width,
            split=self.split,
            images=self.images,
            masks=self.masks,
            blocks=self.blocks,
            jobs=self.jobs,
            ray=self.ray,
            device=self.device,
            evaluate=self.evaluate,
            max_memory=self.max_memory,
            checkpoint_seconds=self.checkpoint_seconds,
            tensorboard=self.tensorboard,
            viewer_port=self.viewer_port if self.viewer else None,
            cache=self.cache,
            quiet=self.quiet,
            on_plan=print_plan if self.json and not self.quiet else None,
        )
        print_report(run.report, self.out, as_json=self.json)
        return 0
