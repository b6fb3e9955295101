"""Light, shadows, mirrors and the camera's rays."""

from typing import get_args

import numpy as np
import pytest

from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.synthetic import raytracer as raycast
from gsynopsis.synthetic.make_scene import UP, Kind, SyntheticScene, world_and_cameras
from gsynopsis.synthetic.objects import ball
from gsynopsis.synthetic.raytracer import (
    RayScene,
    Surface,
    camera_rays,
    decode_srgb,
    encode_srgb,
    render,
    trace,
)
from gsynopsis.synthetic.shapes import Ellipsoid, Plane, column
from gsynopsis.synthetic.textures import checker, plain
from tests.scene.plain_caster import plain_render

SUN = np.repeat(np.array([[0.6, 0.0, 0.8]], np.float32), 4, axis=0)


def world(*surfaces: Surface, ambient: float = 0.25) -> RayScene:
    """A grey floor and a blue dome with a white sun at 0.8 = cos of its angle to the floor."""
    floor = Surface(Plane(column((0, 0, 1)), 0), plain("#808080"))
    dome = Ellipsoid(column((0, 0, 0)), column((50, 50, 50)), inside=True)
    sky = Surface(dome, plain("#0000ff"), glows=True)
    light = np.ones((3, 1), np.float32)

    def glow(spot):
        return np.full_like(spot.position, ambient)

    return RayScene((floor, sky, *surfaces), SUN, True, light, glow)


def one_ray(origin, direction):
    d = np.array(direction, np.float32)[:, None]
    return np.array(origin, np.float32)[:, None], d / np.linalg.norm(d)


def test_a_lit_floor_has_the_colour_of_lamberts_law():
    color, distance, which = trace(world(), one_ray((0, 0, 2), (0, 0, -1)), 0.01, 0)
    np.testing.assert_allclose(color, decode_srgb("#808080") * (0.25 + 0.8), rtol=1e-5)
    assert distance == [2] and which == [0]


def test_a_ball_throws_its_shadow_away_from_the_sun():
    lit = world(ball((0, 0, 1), (0.2, 0.2, 0.2), plain("#ffffff")))
    # The shadow's middle is where the sun's ray through the ball meets the floor.
    dark, _, _ = trace(lit, one_ray((-0.75, 0, 3), (0, 0, -1)), 0.01, 0)
    bright, _, _ = trace(lit, one_ray((0.75, 0, 3), (0, 0, -1)), 0.01, 0)
    np.testing.assert_allclose(dark, decode_srgb("#808080") * 0.25, rtol=1e-5)
    np.testing.assert_allclose(bright, decode_srgb("#808080") * 1.05, rtol=1e-5)


def test_a_mirror_shows_what_a_straight_ray_from_it_sees():
    mirror = ball((0, 0, 5), (1, 1, 1), plain("#000000"), mirror=1.0)
    # Seen from the side at 45°, the mirror sends the ray straight up into the sky or down.
    up, _, _ = trace(world(mirror), one_ray((-9, 0, 5 + 0.5**0.5), (1, 0, 0)), 0.01, 0)
    down, _, _ = trace(world(mirror), one_ray((-9, 0, 5 - 0.5**0.5), (1, 0, 0)), 0.01, 0)
    np.testing.assert_allclose(up, [[0], [0], [1]], atol=1e-5)
    np.testing.assert_allclose(down, decode_srgb("#808080") * 1.05, rtol=1e-4)


def test_rays_go_through_the_pixels_that_the_camera_projects_them_to(rng):
    w2c = look_at(np.array([3.0, 1.0, 2.0]), np.array([0.0, 0.2, 0.5]), UP)
    camera = Camera(64, 48, 50.0, 55.0, 30.5, 25.0, w2c)
    pixels = rng.uniform(0, 48, (200, 2))
    origin, direction = camera_rays(camera, pixels)
    points = (origin + 7 * direction).astype(np.float64)
    x, y, z = w2c[:3, :3] @ points + w2c[:3, 3:]
    found = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
    np.testing.assert_allclose(found, pixels, atol=1e-4)


def test_a_pixel_is_the_mean_of_its_four_samples_in_linear_light():
    # Straight down on a checkerboard of large squares: the pixel on a corner sees two of each.
    board = checker(plain("#ffffff"), plain("#000000"), 1.0, (0, 1))
    dome = Ellipsoid(column((0, 0, 0)), column((50, 50, 50)), inside=True)
    surfaces = (
        Surface(Plane(column((0, 0, 1)), 0), board, glows=True),
        Surface(dome, plain("#0000ff"), glows=True),
    )
    w2c = np.diag([1.0, -1.0, -1.0, 1.0])
    w2c[:3, 3] = [-0.5, 0.5, 10]
    camera = Camera(9, 9, 9.0, 9.0, 4.5, 4.5, w2c)
    image = render(RayScene(surfaces, SUN, True, np.ones((3, 1), np.float32), board), camera)
    assert image.shape == (9, 9, 3) and image.dtype == np.uint8
    assert (image[4, 4] == encode_srgb(np.array(0.5))).all()


@pytest.mark.parametrize("kind", get_args(Kind))
@pytest.mark.parametrize("at_once", [raycast.RAYS_AT_ONCE, 1000])
def test_the_short_cuts_change_no_pixel(kind, at_once, monkeypatch):
    # A thousand rays at once begin with blocks of sky alone, where nothing is lit.
    monkeypatch.setattr(raycast, "RAYS_AT_ONCE", at_once)
    scene, cameras = world_and_cameras(SyntheticScene(kind, 3, 120, 80, 3, 1))
    for camera in cameras:
        np.testing.assert_array_equal(render(scene, camera), plain_render(scene, camera))


@pytest.mark.parametrize("code", ["#000000", "#ffffff", "#0a0b0c", "#c8553d"])
def test_srgb_survives_linear_light(code):
    again = encode_srgb(decode_srgb(code))[:, 0]
    assert "#" + bytes(again.tolist()).hex() == code
