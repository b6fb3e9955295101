"""Everything that a training is given and never changes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from torch import Tensor

from gsynopsis.config import RATES, Config, RateConfig
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Shift
from gsynopsis.scene.scene import Scene
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.levels.size_budget import SizeModel
from gsynopsis.training.sub_scene import Region


@dataclass(frozen=True)
class TrainContext:
    """Scene, settings and machinery of one training.

    Attributes:
        scene: Photos, cameras and points.
        config: Settings.
        renderer: Its device is the training's.
        size_model: The file format; without it level sizes cannot be ordered, nor values rounded.
        group: This process among those that train together; its size divides `train.batch`.
        region: Box of space whose anchors are trained while all else is frozen; None: everything.
        device: What trains and why, in a few words; empty: not said.
        alpha: Opacity of each pixel of a photo on black, float32 [H, W] in steps of 1 / 255, for a
            view, a factor and a shift: every other view is then trained on white, so that what is
            empty stays so. None: photos are opaque.
    """

    scene: Scene
    config: Config
    renderer: Renderer
    size_model: SizeModel | None = None
    group: ProcessGroup = field(default_factory=ProcessGroup)
    region: Region | None = None
    alpha: Callable[[int, float, Shift], Tensor] | None = None
    device: str = ""

    @cached_property
    def rates(self) -> RateConfig:
        """Learning rates of `train.rates`."""
        return RATES[self.config.train.rates]
