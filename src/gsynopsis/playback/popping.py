"""Visibility of a switch of levels: colour changes between successive frames of a flight."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gsynopsis.evaluation.report import Switch
from gsynopsis.model.multi_level import FADE_FRAMES, MultiLevelModel, cross_fade
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.scene.camera import Camera


@dataclass(frozen=True)
class Popping:
    """Change of colour from frame to frame, of 255, worst frame of the flight.

    The camera's own motion is taken out: each frame is compared with the image of the *same*
    camera as the frame before would have rendered it.

    Attributes:
        frames: Frames of the fade; 1: a hard switch.
        largest: Largest change of a pixel's channel.
        mean: Mean change over the image.
    """

    frames: int
    largest: float
    mean: float


def measure_popping(
    before: MultiLevelModel,
    after: MultiLevelModel,
    cameras: Sequence[Camera],
    renderer: Renderer,
    frames: int = FADE_FRAMES,
) -> Popping:
    """Fly along cameras and switch from one state to another, starting at the second frame.

    Args:
        before: State at the first camera.
        after: State from the end of the fade on.
        cameras: A smooth flight of at least `frames` + 1 cameras.
        renderer: Any.
        frames: Length of the fade; 1 switches at once.

    Raises:
        ValueError: the flight is shorter than the fade.
    """
    if len(cameras) <= frames:
        raise ValueError(f"a fade over {frames} frames needs {frames + 1} cameras")
    largest = mean = 0.0
    background = torch.zeros(3, device=renderer.device)

    def rendered(gaussians: Gaussians, camera: Camera) -> np.ndarray:
        with torch.no_grad():
            image = renderer.render(gaussians, camera, background).image
        return image.clamp(0, 1).cpu().numpy() * 255.0

    for number in range(1, frames + 1):
        camera = cameras[number]
        old, new = before.named(camera), after.named(camera)
        last = rendered(cross_fade(old, new, (number - 1) / frames), camera)
        this = rendered(cross_fade(old, new, number / frames), camera)
        change = np.abs(this - last)
        largest, mean = max(largest, float(change.max())), max(mean, float(change.mean()))
    return Popping(frames, largest, mean)


def measure_switches(
    levels: LevelSet, cameras: Sequence[Camera], renderer: Renderer
) -> tuple[Switch, ...]:
    """Popping at each switch of whole levels, at once and faded over `FADE_FRAMES`.

    Args:
        levels: All levels.
        cameras: A smooth flight of at least `FADE_FRAMES` + 1 cameras, one for each frame.
        renderer: Any.
    """
    states: list[MultiLevelModel] = []
    for number in range(len(levels.levels)):
        part = levels.upto(number)
        region = np.full(part.levels[-1].anchors, number, np.uint8)
        states.append(MultiLevelModel(part, region, renderer.device))
    found: list[Switch] = []
    for level, (old, new) in enumerate(itertools.pairwise(states), start=1):
        hard = measure_popping(old, new, cameras, renderer, 1)
        soft = measure_popping(old, new, cameras, renderer)
        found.append(Switch(level, hard.largest, hard.mean, soft.largest, soft.mean))
    return tuple(found)
