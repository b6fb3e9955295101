"""Names that lead elsewhere, and what all scenes must have."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.read import read_colmap
from gsynopsis.scene.scene import load_scene
from gsynopsis.scene.stored import ORIENTATION
from gsynopsis.scene.views import check_listing, parallax_notes, place_of

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


def test_what_photos_say_and_is_not_followed_is_a_line(tiny) -> None:
    root = tiny(("a.jpg", "b.png", "c.png"))
    exif, profile = Image.Exif(), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    exif[ORIENTATION] = 2
    with Image.open(root / "images" / "a.jpg") as image:
        image.save(root / "images" / "a.jpg", exif=exif, icc_profile=profile.tobytes())
    (note,) = load_scene(root).notes
    assert note.startswith("1 photos have an EXIF tag that turns them (a.jpg): it is ignored")
    adobe = profile.tobytes().replace(
        "sRGB built-in".encode("utf-16-be"), "Adobe RGB (19".encode("utf-16-be")
    )
    with Image.open(root / "images" / "b.png") as image:
        image.save(root / "images" / "b.png", icc_profile=adobe)
    assert any("1 photos have colours of Adobe RGB (19, which" in n for n in load_scene(root).notes)


@pytest.mark.parametrize(("step", "told"), [(0.02, True), (0.3, False)])
def test_cameras_in_nearly_one_place_are_a_line(step: float, told: bool) -> None:
    places, points = np.array([[0.0, 0, 0], [step, 0, 0]]), np.full((9, 3), 5.0)
    assert bool(parallax_notes(places, points)) is told
