"""`gsynopsis scene`: photos or a video in, a scene with poses out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.capture.matching import Matching
from gsynopsis.capture.sfm import FEATURES, LensModel, Mapper
from gsynopsis.capture.video import FRAMES
from gsynopsis.cli.bounds import bounded, with_training
from gsynopsis.cli.defaults import said


@dataclass(frozen=True)
class SceneCommand:
    """Estimate poses of photos or a video, for `train`; the same command goes on after a stop.

    Attributes:
        photos: Folder of photos, or one with images/ in it, or a video (by ffmpeg).
        out: Folder of the scene: images/ without distortion, sparse/0/, a report and an image.
        matching: Which photos are compared with which; auto: all with all up to a few hundred,
            neighbours where names are numbered as a camera does it.
        mapper: Global mapping is quick; auto tries incremental mapping where that places too few.
        lens: Camera model to estimate; it is undistorted afterwards.
        features: Most keypoints of a photo.
        up: Away from the ground, in the axes of the scene without it.
        frames: Most photos taken from a video: the sharpest, an even stretch of motion apart.
        alpha: Alpha channels of photos are their masks, which go into masks/.
        json: Print scene.json instead of lines.
        quiet: Say nothing on the way.
    """

    photos: Positional[Path]
    out: Positional[Path]
    matching: Matching = "auto"
    mapper: Mapper = "auto"
    lens: LensModel = "OPENCV"
    features: int = FEATURES
    up: Annotated[tuple[float, float, float] | None, said("from the photos")] = None
    frames: int = FRAMES
    alpha: bool = False
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Estimate, print."""
        import json

        with with_training():
            from gsynopsis.jobs.estimate_poses import PoseOptions, estimate_poses
            from gsynopsis.monitor.display import Display
        features = int(bounded("--features", self.features, 256, 65_536))
        frames = int(bounded("--frames", self.frames, 3, 10_000))
        options = PoseOptions(
            self.matching, self.mapper, self.lens, features, self.up, frames, self.alpha
        )
        with Display(quiet=self.quiet) as display:
            report = estimate_poses(self.photos, self.out, options, display)
        if self.json:
            print(json.dumps(report.document(), indent=1))
        else:
            print(report.text())
        return 0
