"""Names that lead elsewhere, and what all scenes must have."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms

from gsynopsis.capture.photo_set import gather, prepare
from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.read import read_colmap
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.photos import load_photo
from gsynopsis.scene.stored import ORIENTATION
from gsynopsis.scene.views import (
    NEAR,
    check_listing,
    parallax_notes,
    place_of,
    with_fallback_points,
)

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


def swapped(profile: bytes) -> bytes:
    """A profile whose red is another's green: the names of the two entries change places."""
    return profile.replace(b"rXYZ", b"_XYZ").replace(b"gXYZ", b"rXYZ").replace(b"_XYZ", b"gXYZ")


@pytest.mark.parametrize(("kind", "mode"), [("png", "RGB"), ("png", "RGBA"), ("jpg", "RGB")])
def test_colors_of_another_profile_are_converted(tmp_path, kind: str, mode: str) -> None:
    own = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    image = Image.new("RGB", (16, 16), (200, 60, 20)).convert(mode)
    wide = [swapped(own), own, b"no profile", None]
    for number, profile in enumerate(wide):
        path = tmp_path / f"{number}.{kind}"
        image.save(path, icc_profile=profile, **({"quality": 100} if kind == "jpg" else {}))
        found = load_photo(path, 1.0).reshape(-1, 3).mean(axis=0)
        expected = (60, 200, 20) if number == 0 else (200, 60, 20)
        np.testing.assert_allclose(found, expected, atol=3)


def test_photos_whose_poses_are_estimated_are_converted_and_keep_their_tags(tmp_path) -> None:
    own = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    exif = Image.Exif()
    exif[0x010F] = "maker"
    for number in range(3):
        image = Image.new("RGB", (64, 48), (200, 60 + number, 20))
        profile = swapped(own) if number else own
        image.save(tmp_path / f"{number}.jpg", icc_profile=profile, exif=exif, quality=100)
    gathered = gather(tmp_path)
    assert any(note.startswith("2 photos have colours of ") for note in gathered.notes)
    prepare(gathered, tmp_path / "out")
    for number in range(3):
        with Image.open(tmp_path / "out" / f"{number}.jpg") as image:
            red, green, _ = np.asarray(image).reshape(-1, 3).mean(axis=0)
            assert image.getexif()[0x010F] == "maker"
            assert (image.info.get("icc_profile") is None) == bool(number)
        assert (green > red) == bool(number)


def test_what_photos_say_and_is_not_followed_is_a_line(tiny) -> None:
    root = tiny(("a.jpg", "b.png", "c.png"))
    exif, profile = Image.Exif(), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    exif[ORIENTATION] = 2
    with Image.open(root / "images" / "a.jpg") as image:
        image.save(root / "images" / "a.jpg", exif=exif, icc_profile=profile.tobytes())
    (note,) = load_scene(root).notes
    assert note.startswith("1 photos have an EXIF tag that turns them (a.jpg): it is ignored")
    for name, told in ((b"sRGB built-in", False), (b"Adobe RGB (19", True)):
        # Another name alone changes no colour; red and green the other way round do.
        named = name.decode().encode("utf-16-be")
        other = profile.tobytes().replace("sRGB built-in".encode("utf-16-be"), named)
        with Image.open(root / "images" / "b.png") as image:
            image.save(root / "images" / "b.png", icc_profile=swapped(other) if told else other)
        note = "1 photos have colours of Adobe RGB (19: converted to sRGB"
        assert (note in load_scene(root).notes) is told


@pytest.mark.parametrize(("step", "told"), [(0.02, True), (0.3, False)])
def test_cameras_in_nearly_one_place_are_a_line(step: float, told: bool) -> None:
    places, points = np.array([[0.0, 0, 0], [step, 0, 0]]), np.full((9, 3), 5.0)
    assert bool(parallax_notes(places, points)) is told


def test_points_that_stand_in_are_where_most_cameras_look(small_room):
    """Point by point: many cameras see it, and it is not right before any."""
    root = small_room / "sparse" / "0"
    listing = dataclasses.replace(read_colmap(small_room, root), points=np.zeros((0, 3)))
    found = with_fallback_points(listing)
    cameras = [view.camera for view in listing.views]
    places = np.stack([camera.position for camera in cameras])
    radius = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    counts = list[int]()
    for point in found.points[::100]:
        inside = 0
        for camera in cameras:
            x, y, z = camera.w2c[:3, :3] @ point + camera.w2c[:3, 3]
            column, row = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
            if z > 0 and 0 < column < camera.width and 0 < row < camera.height:
                assert z >= NEAR * radius
                inside += 1
        counts.append(inside)
    assert found.random_points and min(counts) >= max(counts) / 2 > 1
