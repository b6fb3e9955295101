"""A scene, a decoder and a renderer without training: what an evaluation needs, made by hand."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from gsynopsis.evaluation.metrics import Image8
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Gaussians, Rendering
from gsynopsis.scene.account import Account
from gsynopsis.scene.camera import Camera
from tests.level_sets import make_level_set


def look_from(eye: tuple[float, float, float], width: int, height: int) -> Camera:
    """A camera at `eye` that looks along +z."""
    w2c = np.eye(4)
    w2c[:3, 3] = [-e for e in eye]
    return Camera(width, height, 1.2 * width, 1.2 * width, width / 2, height / 2, w2c)


@dataclass(frozen=True)
class FakeView:
    name: str
    camera: Camera


@dataclass
class FakeScene:
    """Photos are smooth patterns that depend on view and size."""

    views: tuple[FakeView, ...]
    test: tuple[int, ...]
    name: str = "pattern"
    notes: tuple[str, ...] = ("a scene made by hand",)
    account: Account = field(default_factory=Account)
    train: tuple[int, ...] = ()
    masked: bool = False
    judged: Callable[[int, float], np.ndarray | None] = lambda view, factor: None
    loads: list[tuple[int, float]] = field(default_factory=list)

    def camera(self, view: int, factor: float) -> Camera:
        return self.views[view].camera.scaled(factor)

    def image(self, view: int, factor: float) -> Image8:
        self.loads.append((view, factor))
        return pattern(self.camera(view, factor), view)

    def fingerprint(self) -> str:
        return "0" * 64


def pattern(camera: Camera, seed: float) -> Image8:
    """A picture with edges and gradients, uint8 [H, W, 3], not writeable like a real photo."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    u, v = x / camera.width, y / camera.height
    disc = ((u - 0.5) ** 2 + (v - 0.45) ** 2 < 0.06).astype(np.float64)
    stripes = 0.5 + 0.5 * np.sin(40 * u * v + seed)
    planes = [0.2 + 0.6 * u, 0.15 + 0.5 * stripes * (1 - disc), 0.25 + 0.55 * disc + 0.2 * v]
    image = np.clip(np.stack(planes, axis=-1) * 255, 0, 255).astype(np.uint8)
    image.flags.writeable = False
    return image


def fake_scene(views: int = 10, width: int = 96, height: int = 64) -> FakeScene:
    made = tuple(
        FakeView(f"view_{i:02d}.png", look_from((0.1 * i, 0.0, -3.0), width, height))
        for i in range(views)
    )
    test = tuple(range(0, views, 4))
    return FakeScene(made, test, train=tuple(i for i in range(views) if i not in test))


@dataclass
class LevelDecoder:
    """Encodes the level in the Gaussians: one Gaussian whose opacity is the level's noise."""

    noise: tuple[float, ...]
    calls: list[tuple[int, int]] = field(default_factory=list)

    def decode(self, camera: Camera, level: int) -> Gaussians:
        self.calls.append((level, camera.width))
        return Gaussians(
            means=torch.tensor([[0.0, 0.0, 2.0]]),
            quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
            scales=torch.full((1, 3), 0.5),
            opacities=torch.tensor([self.noise[level]]),
            colors=torch.ones(1, 3),
        )


@dataclass
class PatternRenderer:
    """Draws the photo of a scene's view plus a constant: the error is known exactly."""

    truth: Callable[[Camera], Image8]
    name: str = "pattern"

    @property
    def device(self) -> torch.device:
        return torch.device("cpu")

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        offset = float(gaussians.opacities[0])
        image = torch.tensor(self.truth(camera).astype(np.float32) / 255.0) + offset
        alpha = torch.ones(image.shape[:2])
        visible = torch.ones(len(gaussians), dtype=torch.bool)
        return Rendering(image, alpha, visible, lambda: torch.zeros(len(gaussians), 2))


def renderer_of(scene: FakeScene) -> PatternRenderer:
    """The renderer that knows the photos of a fake scene."""

    def truth(camera: Camera) -> Image8:
        position = np.round(camera.position, 6)
        for number, view in enumerate(scene.views):
            if np.array_equal(np.round(view.camera.position, 6), position):
                return pattern(camera, number)
        return pattern(camera, float(position @ [1.0, 2.0, 3.0]))

    return PatternRenderer(truth)


def level_set(seed: int = 0) -> LevelSet:
    """Four nested random levels; only counts and bytes matter here."""
    return make_level_set(np.random.default_rng(seed))
