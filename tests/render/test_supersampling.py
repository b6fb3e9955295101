"""Small images show what large ones do; images of the size of training stay as they are."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from gsynopsis.render.base import ANTIALIASED, Gaussians, Rendering
from gsynopsis.render.choose import make_renderer
from gsynopsis.render.supersampling import (
    PIXELS_MAX,
    SUPERSAMPLING_MAX,
    render_reduced,
    supersampling,
)
from gsynopsis.scene.camera import Camera

TRAINED = Camera(128, 96, 120.0, 120.0, 64.0, 48.0, np.eye(4))
BLACK = torch.zeros(3)


def wall(generator: torch.Generator) -> Gaussians:
    """Small opaque Gaussians that cover the view together, each a pixel of training wide."""
    rows, columns = torch.meshgrid(torch.arange(-70, 71), torch.arange(-90, 91), indexing="ij")
    means = torch.stack([columns / 60.0, rows / 60.0, torch.full(rows.shape, 2.0)], dim=2)
    means = means.reshape(-1, 3).float()
    count = len(means)
    return Gaussians(
        means,
        torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        torch.full((count, 3), 0.008),
        torch.full((count,), 0.9),
        0.5 + 0.5 * torch.rand(count, 3, generator=generator),
        focals=(120.0, 120.0),
    )


@pytest.fixture
def gaussians() -> Gaussians:
    return wall(torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("ratio", "times"), [(2.0, 1), (1.0, 1), (0.7, 1), (0.6, 2), (0.5, 2), (0.34, 3), (0.125, 8)]
)
def test_how_much_larger_follows_the_focal_length(
    gaussians: Gaussians, ratio: float, times: int
) -> None:
    camera = TRAINED.resized(round(128 * ratio), round(96 * ratio))
    assert supersampling(gaussians, camera) == times
    for unknown in (None, ANTIALIASED, (math.inf, math.inf)):
        assert supersampling(replace(gaussians, focals=unknown), camera) == 1


def test_a_file_cannot_order_images_without_bound(gaussians: Gaussians) -> None:
    hostile = replace(gaussians, focals=(1e12, 1e12))
    assert supersampling(hostile, TRAINED.resized(8, 6)) == SUPERSAMPLING_MAX
    for camera in (TRAINED.resized(1600, 1200), TRAINED.resized(8000, 6000)):
        times = supersampling(hostile, camera)
        pixels = camera.width * camera.height
        assert times == 1 or times**2 * pixels <= PIXELS_MAX


def test_at_the_size_of_training_the_image_is_the_renderers(gaussians: Gaussians) -> None:
    renderer = make_renderer("cpu")
    plain = renderer.render(gaussians, TRAINED, BLACK).image
    assert torch.equal(render_reduced(renderer, gaussians, TRAINED, BLACK), plain)


def test_a_small_image_is_the_large_one_reduced_and_no_surface_opens(gaussians: Gaussians) -> None:
    renderer, small = make_renderer("cpu"), TRAINED.resized(16, 12)
    assert small.focal_length == pytest.approx(15)
    large = renderer.render(gaussians, TRAINED, BLACK).image.numpy()
    expected = np.stack(
        [
            np.asarray(Image.fromarray(large[..., k]).resize((16, 12), Image.Resampling.LANCZOS))
            for k in range(3)
        ],
        axis=2,
    )
    found = render_reduced(renderer, gaussians, small, BLACK).numpy()
    assert np.abs(found - expected).max() < 1e-6
    plain = renderer.render(gaussians, small, BLACK).image.numpy()
    mean = large.mean()
    assert abs(found.mean() - mean) < 0.01 * mean < 0.05 * mean < mean - plain.mean()


class Broken:
    """A renderer with one pixel that is no number."""

    name, device = "broken", torch.device("cpu")

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        image = torch.full((camera.height, camera.width, 3), 0.5)
        image[camera.height // 2, camera.width // 2] = torch.nan
        return Rendering(image, image[..., 0], torch.zeros(0), lambda: torch.zeros(0, 2))


def test_a_pixel_that_is_no_number_is_not_hidden(gaussians: Gaussians) -> None:
    image = render_reduced(Broken(), gaussians, TRAINED.resized(16, 12), BLACK)
    assert not bool(torch.isfinite(image).all())
