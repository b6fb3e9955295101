"""`gsynopsis unfold`: levels of a finished splat, or of a run's full model anew."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gsynopsis.cli.bounds import bounded, with_training
from gsynopsis.cli.defaults import said
from gsynopsis.cli.flags import Changes, asked_of
from gsynopsis.cli.report import print_report
from gsynopsis.cli.splat_options import AskedCameras, AskedUp, asked_up


@dataclass(frozen=True)
class Unfold:
    """Train levels of a finished splat without its photos, or make a run's levels another way.

    Attributes:
        source: PLY (3DGS, SuperSplat, Brush, Postshot, nerfstudio), compressed PLY, SPZ, SOG, GLB,
            .splat, or a lod-meta.json: its renders are trained on. Or the folder of a run whose
            full model is trained: that is not trained again.
        out: Folder of the new run; repeat the same command to go on after a stop.
        overrides: Settings to change; of a run only those of levels, and `--steps` are theirs.
        views: Renders of a splat to train on; of cameras that are given without `--scene` all are
            taken.
        width: Width of these renders, pixels.
        up: Away from the ground, in the axes of the splat's file: x y z, or an axis as +z or -y.
        cameras: Of the splat's training: a cameras.json of 3DGS, a COLMAP model or scene, or a
            transforms.json; it is rendered from these.
        scene: Folder of the photos that the splat was made of, in its world: they teach beside
            its renders, and the report is of those that are held out.
        max_memory: Limit of memory, GiB: growth stops in time, and what cannot start is refused.
        cache: Folder that keeps decoded renders; else memory, or RUN/photos.
        checkpoint_seconds: Seconds between checkpoints of training on a splat.
        device: What trains: `auto` (CUDA, else the CPU), `cpu`, `cuda`, `webgpu` (any GPU, tested
            before), or `webgpu:NAME` for the adapter whose name holds NAME.
        evaluate: Write the report of an evaluation on the held-out views beside the file.
        json: Print metrics.json instead of the table.
        quiet: Show no progress.
    """

    source: Positional[Path]
    out: Path
    overrides: Annotated[Changes, arg(name="")] = field(default_factory=Changes)
    views: int = 112
    width: int = 480
    up: AskedUp = None
    cameras: AskedCameras = None
    scene: Annotated[Path | None, said("renders alone")] = None
    max_memory: Annotated[float | None, said("no limit")] = None
    cache: Annotated[Path | None, said("memory, or RUN/photos")] = None
    checkpoint_seconds: float = 120.0
    device: str = "auto"
    evaluate: bool = True
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Train on renders, or go on from a full model."""
        bounded("--views", self.views, 8, 100_000)
        bounded("--width", self.width, 32, 4096)
        up = asked_up(self.up)
        asked = asked_of(self.overrides)
        with with_training():
            from gsynopsis.jobs.unfold import is_run, unfold
        if is_run(self.source) and "train.steps" in asked:
            asked["levels.steps"] = asked.pop("train.steps")
        run = unfold(
            self.source,
            self.out,
            asked,
            views=self.views,
            width=self.width,
            up=up,
            cameras=self.cameras,
            scene=self.scene,
            device=self.device,
            evaluate=self.evaluate,
            max_memory=self.max_memory,
            checkpoint_seconds=self.checkpoint_seconds,
            cache=self.cache,
            quiet=self.quiet,
        )
        print_report(run.report, self.out, as_json=self.json)
        return 0
