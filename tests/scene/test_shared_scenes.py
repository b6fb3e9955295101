"""Scenes rebuilt from public reports load as their README says."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.model import rotation_from_quaternion
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene

CASES = Path(__file__).parents[3] / "shared" / "cases" / "scenes"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="no shared cases: NOT tried")
WHOLE = (
    "byte_order_mark",
    "case_of_suffix",
    "convert_py_distorted",
    "decimal_commas",
    "display_p3",
    "exif_upside_down_upright_camera",
    "float_sizes",
    "masks_named_mask",
    "nerfstudio_colmap_folder",
    "nfd_names",
    "no_observation_lines_three_words",
    "points_empty",
    "points_ply_only",
    "quaternions_three_digits",
    "tj_backslashes",
    "tj_masks",
    "tj_ply_float_colours",
    "tj_scaled_rotation",
    "tj_split",
    "two_models_small_first",
    "utm_coordinates",
    "wrong_counts",
)
"""All eight views, with the lens, poses and pixels of the unchanged scene."""
IN_PART = {"photos_not_in_the_model": 3, "tj_nan_poses": 6, "two_photos_deleted": 6}
"""Views of scenes that lack some."""
STAND_INS = ("points_empty",)
COARSE = {"quaternions_three_digits": 0.01, "tj_scaled_rotation": 1e-3}
"""Poses' deviation, where the file has few digits."""
SAID = {
    "case_of_suffix": "IMG_0000.jpg",
    "display_p3": "Display P3",
    "exif_upside_down_upright_camera": "it is ignored, poses are taken for the pixels as stored",
    "masks_named_mask": "8 of 8 photos, in mask/",
    "nfd_names": "Unicode form",
    "photos_not_in_the_model": "IMG_0003.jpg",
    "points_empty": "stand in",
    "rotation_only": "no parallax",
    "tj_equirectangular": "8 panoramas",
    "tj_masks": "8 of 8 photos, named by transforms.json",
    "tj_nan_poses": "IMG_0002.jpg, images/IMG_0004.jpg",
    "tj_split": "test_filenames",
    "two_models_small_first": "sparse/0 with 3 photos",
    "two_photos_deleted": "IMG_0003.jpg, IMG_0005.jpg",
    "utm_coordinates": "499956 5399990 298",
}
"""Words that are told."""


def told(scene: Scene) -> str:
    return " ".join([scene.account.text(), *scene.notes])


@pytest.mark.parametrize("name", WHOLE)
def test_a_case_is_the_scene_that_it_was_made_from(name: str) -> None:
    base = json.loads((CASES / "base" / "base.json").read_text("utf-8"))
    found = load_scene(CASES / name, "every8")
    stored = sorted(found.views, key=lambda view: view.name)
    assert len(stored) == len(base["frames"]) == 8
    for view, frame in zip(stored, base["frames"], strict=True):
        camera = view.camera
        lens = [camera.fx, camera.fy, camera.cx, camera.cy]
        assert (camera.width, camera.height) == (base["w"], base["h"])
        assert np.allclose(lens, base["K"], atol=2e-3)
        rotation = rotation_from_quaternion(frame["q"])
        assert np.allclose(camera.w2c[:3, :3], rotation, atol=COARSE.get(name, 1e-5))
        if name != "utm_coordinates":
            centre = -camera.w2c[:3, :3].T @ camera.w2c[:3, 3]
            expected = -rotation.T @ np.array(frame["t"])
            assert np.allclose(centre, expected, atol=COARSE.get(name, 1e-5) * 10)
    assert (len(found.points) == 150) is (name not in STAND_INS)
    assert SAID.get(name, "") in told(found)


@pytest.mark.parametrize("name", ["display_p3", "tj_split"])
def test_the_pixels_of_a_case_are_those_of_its_scene(name: str) -> None:
    found, plain = load_scene(CASES / name, "every8"), load_scene(CASES / "wrong_counts", "every8")
    for view in range(8):
        off = found.image(view).astype(int) - plain.image(view)
        assert np.abs(off).mean() < 2.0  # JPEG, stored once more


def test_colours_of_points_are_colours_whatever_their_type() -> None:
    found, plain = (load_scene(CASES / n, "every8") for n in ("tj_ply_float_colours", "tj_split"))
    assert np.allclose(found.colors, plain.colors, atol=1.01 / 255)


@pytest.mark.parametrize("name", IN_PART)
def test_what_a_case_lacks_is_named(name: str) -> None:
    found = load_scene(CASES / name, "every8")
    assert len(found.views) == IN_PART[name] and SAID[name] in told(found)


def test_lists_of_a_transforms_file_say_what_is_held_out() -> None:
    found = load_scene(CASES / "tj_split", "every8")
    names = {found.views[view].name for view in found.test}
    assert {Path(name).stem for name in names} == {"IMG_0003", "IMG_0006"}


@pytest.mark.parametrize("name", ["rotation_only", "tj_equirectangular"])
def test_a_case_of_one_place_or_of_panoramas_says_so(name: str) -> None:
    assert SAID[name] in told(load_scene(CASES / name, "every8"))


def test_photos_of_a_lens_of_metashape_lose_nothing() -> None:
    found = load_scene(CASES / "tj_metashape_k4", "every8")
    assert len(found.views) == 8 and found.views[0].camera.height == 54


def test_poses_of_a_program_without_any_are_not_estimated_without_a_word() -> None:
    with pytest.raises(SceneError, match=r"cameras\.xml"):
        load_scene(CASES / "pose_metashape", "every8")
