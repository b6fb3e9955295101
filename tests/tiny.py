"""Tiny scenes and models, made in memory, for the tests of model and training."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gsynopsis.config import Config, GrowthConfig, Joint, ModelConfig, Sequential, TrainConfig
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import new_model
from gsynopsis.scene.camera import STILL, Camera, Shift
from gsynopsis.scene.photos import AS_STORED, PhotoForm
from gsynopsis.scene.scene import PhotoCache, Scene, View

TINY_MODEL = ModelConfig(fusion="none", slots=3, grids=4, table_log2=6, codebook=8, hidden=8)
PLAIN_JOINT = Joint(
    steps=20,
    prune_share=0,
    levels_per_step=2,
    loss_weights=(),
    weights="separate",
    coding_loss=0,
)
"""Joint levels without what later experiments added."""


def look_at(eye: np.ndarray, target: np.ndarray, width: int, height: int) -> Camera:
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, -1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    w2c = np.eye(4)
    w2c[:3, :3], w2c[:3, 3] = rotation, -rotation @ eye
    return Camera(width, height, width * 1.0, width * 1.0, width / 2, height / 2, w2c)


class Painted(PhotoCache):
    """Photos that exist in memory only: a smooth colour field seen through each camera."""

    def __init__(self, size: tuple[int, int]) -> None:
        super().__init__()
        self.size = size

    def get(
        self, path: Path, factor: float, shift: Shift = STILL, form: PhotoForm = AS_STORED
    ) -> np.ndarray:
        width, height = (max(1, round(s / factor)) for s in self.size)
        turn = int(path.stem) * 0.3
        y, x = np.mgrid[0:height, 0:width]
        u, v = (x + 0.5 + shift[0]) / width, (y + 0.5 + shift[1]) / height
        color = np.stack([u, v, 0.5 + 0.5 * np.sin(6 * u + 4 * v + turn)], axis=2)
        return (color * 255).round().astype(np.uint8)


class PointsAlone(Scene):
    """A scene without backdrop: what tests count, and the luck of seeds, is of its points alone."""

    backdrop = np.zeros((0, 3))  # type: ignore[assignment]


def tiny_scene(views: int = 9, size: tuple[int, int] = (24, 16), points: int = 120) -> Scene:
    rng = np.random.default_rng(5)
    cloud = rng.uniform(-1, 1, (points, 3))
    places = []
    for k in range(views):
        angle = 0.25 * (k - views / 2)
        eye = np.array([4 * np.sin(angle), -0.3 + 0.05 * k, -4 * np.cos(angle)])
        places.append(View(f"{k:03d}.png", look_at(eye, np.zeros(3), *size), Path(f"{k:03d}.png")))
    test = tuple(range(0, views, 8))
    train = tuple(k for k in range(views) if k % 8)
    colors = np.full((points, 3), 128, np.uint8)
    return PointsAlone(
        "tiny", Path("tiny"), tuple(places), cloud, colors, train, test, cache=Painted(size)
    )


def tiny_config(**levels: Any) -> Config:
    """Thirty steps, then levels; `mode` chooses how they are made, joint if it is not given."""
    growth = GrowthConfig(every=5, until=0.8, grow_visits=0.2, threshold=1e-5)
    sequential = levels.pop("mode", "joint") == "sequential"
    return Config(
        model=TINY_MODEL,
        train=TrainConfig(steps=30, growth=growth),
        levels=replace(Sequential(steps=20) if sequential else PLAIN_JOINT, **levels),
    )


def half_size(config: Config) -> Config:
    """The same on photos of half their size, sampled at four places of a pixel."""
    return replace(config, scale=2.0, train=replace(config.train, subpixel_jitter=2))


def tiny_model(config: ModelConfig = TINY_MODEL, seed: int = 0) -> AnchorModel:
    """An untrained model that shows something: offsets, features and opacities are scattered."""
    model = new_model(tiny_scene(), config, torch.Generator().manual_seed(seed))
    generator = torch.Generator().manual_seed(seed + 1)
    with torch.no_grad():
        model.offsets.copy_(torch.randn(model.offsets.shape, generator=generator))
        model.table.copy_(torch.randn(model.table.shape, generator=generator))
        model.part(-1).networks["opacity_b2"].fill_(0.3)
    return model
