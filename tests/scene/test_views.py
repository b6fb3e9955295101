"""Names that lead elsewhere, and what all scenes must have."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap import read_colmap
from gsynopsis.scene.views import check_listing, place_of

LIST, FOLDER = Path("sparse/0/images.bin"), Path("scene/images")


@pytest.mark.parametrize("name", ["a.png", "left/a.b.c.jpg", "./x/ä ö.png", "..a.png", "10:30.png"])
def test_names_inside_the_folder_are_taken(name):
    place = place_of(LIST, FOLDER, name)
    assert FOLDER in place.parents and place.name == name.split("/")[-1]


@pytest.mark.parametrize(
    "name",
    [
        "../a.png",
        "x/../../a.png",
        "/etc/passwd",
        "",
        ".",
        "..",
        "a\0.png",
        "C:/a.png",
        "..\\a.png",
        "\ud800.png",
        "x" * 300,
    ],
)
def test_names_that_lead_out_of_the_folder_are_refused(name):
    with pytest.raises(
        SceneError, match=r"images\.bin: image name: found .* inside scene/images"
    ) as e:
        place_of(LIST, FOLDER, name)
    assert "\n" not in str(e.value) and str(e.value).encode()


@pytest.fixture
def listing(tiny):
    root = tiny()
    return read_colmap(root, root / "sparse" / "0")


def test_a_whole_listing_passes(listing):
    check_listing(listing)
    assert len(listing.views) == 3


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_images_are_refused(listing, count):
    with pytest.raises(SceneError, match=rf"images: found {count}, expected at least 2; a scene"):
        check_listing(dataclasses.replace(listing, views=listing.views[:count]))


def test_no_points_are_refused(listing):
    with pytest.raises(SceneError, match="points: found 0, expected at least 1; the reconstr"):
        check_listing(dataclasses.replace(listing, points=np.zeros((0, 3))))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_point_that_is_not_finite_is_refused(listing, value):
    points = listing.points.copy()
    points[4, 1] = value
    with pytest.raises(SceneError, match=r"point 4 xyz: found \[.*(nan|inf).*\], expected fin"):
        check_listing(dataclasses.replace(listing, points=points))


def test_an_image_listed_twice_is_refused(listing):
    views = (*listing.views, listing.views[0])
    with pytest.raises(SceneError, match=r"image b\.png: found it twice, expected each image"):
        check_listing(dataclasses.replace(listing, views=views))


def test_cameras_that_all_stand_in_one_place_are_refused(listing):
    same = listing.views[0].camera
    views = tuple(dataclasses.replace(view, camera=same) for view in listing.views)
    with pytest.raises(SceneError, match="poses: found all cameras in one place, expected at le"):
        check_listing(dataclasses.replace(listing, views=views))
