"""Splits that files list, and the rule where they list none."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.splits import Split, SplitLists

NAMES = [f"{letter}.png" for letter in "abcdef"]


def frame(name: str, number: int) -> dict[str, object]:
    pose = np.eye(4)
    pose[0, 3], pose[1, 3] = number, number % 2
    return {"file_path": name, "transform_matrix": pose.tolist()}


def write(root: Path, lists: dict[str, object], listed: list[str] = NAMES) -> Path:
    for name in NAMES:
        Image.new("RGB", (16, 12)).save(root / name)
    frames = [frame(name, number) for number, name in enumerate(listed)]
    values = {"camera_angle_x": 0.7, **lists, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(values))
    return root


def write_parts(root: Path, letters: dict[str, str]) -> Path:
    """Blender's files: photos of each by their letters."""
    write(root, {})
    (root / "transforms.json").unlink()
    for kind, chosen in letters.items():
        frames = [frame(name, ord(name[0])) for name in named(chosen)]
        values = {"camera_angle_x": 0.7, "frames": frames}
        (root / f"transforms_{kind}.json").write_text(json.dumps(values))
    return root


def parts(scene: Scene) -> tuple[str, str]:
    return tuple("".join(scene.views[i].name[0] for i in p) for p in (scene.train, scene.test))


def named(letters: str) -> list[str]:
    return [f"{letter}.png" for letter in letters]


@pytest.mark.parametrize(
    ("train", "test", "val", "split", "expected"),
    [
        ("abde", "cf", "cf", "every8", ("abde", "cf")),
        ("abd", "cf", "e", "every8", ("abd", "cf")),
        ("abd", "cf", "e", "validation", ("abd", "e")),
        ("abde", None, "cf", "every8", ("abde", "cf")),
        (None, "cf", None, "every8", ("abde", "cf")),
        (None, "cf", "a", "every8", ("bde", "cf")),
        ("abde", None, None, "every8", ("abde", "cf")),
        ("abcdef", "cf", None, "every8", ("abde", "cf")),
        ("abcdef", None, None, "every8", ("abcdef", "abcdef")),
        (None, "abcdef", None, "every8", ("abcdef", "abcdef")),
    ],
)
def test_lists_of_a_transforms_json_are_followed(
    tmp_path: Path, train, test, val, split: Split, expected
) -> None:
    texts = {"train": train, "test": test, "val": val}
    lists = {f"{key}_filenames": named(text) for key, text in texts.items() if text is not None}
    scene = load_scene(write(tmp_path, lists), split)
    assert parts(scene) == expected
    assert scene.notes[1].startswith(f"split by {' and '.join(lists)} of transforms.json")
    assert f"held out by {' and '.join(lists)} of transforms.json" in scene.account.text()
    unused = 6 - len({*scene.train, *scene.test})
    assert len(scene.account.left_out.get("of other split lists or none", ())) == unused


def test_names_in_lists_are_found_as_photos_are_and_unknown_ones_are_counted(
    tmp_path: Path,
) -> None:
    lists = {"train_filenames": ["./a.png", "B.PNG", "c"], "test_filenames": ["d.png", "gone.png"]}
    scene = load_scene(write(tmp_path, lists))
    assert parts(scene) == ("abc", "d")
    assert "test_filenames has 1 names of no photo in use" in scene.account.text()
    assert "2 of other split lists or none (e.png, f.png)" in scene.account.text()


@pytest.mark.parametrize("lists", [{"test_filenames": []}, {"val_filenames": ["gone.png"]}])
def test_lists_without_a_photo_leave_the_rule(tmp_path: Path, lists: dict[str, object]) -> None:
    scene = load_scene(write(tmp_path, lists))
    assert parts(scene) == ("bcdef", "a") and "rule every8" in scene.account.text()


@pytest.mark.parametrize("value", ["a.png", [1], {"a": 1}])
def test_a_list_of_another_kind_is_one_line(tmp_path: Path, value: object) -> None:
    with pytest.raises(SceneError, match=r"transforms\.json: test_filenames: found .*a list of te"):
        load_scene(write(tmp_path, {"test_filenames": value}))


@pytest.mark.parametrize(
    ("kinds", "split", "expected"),
    [
        (("test", "val"), "every8", ("abc", "de")),
        (("test", "val"), "validation", ("abc", "f")),
        (("val",), "every8", ("abc", "f")),
    ],
)
def test_blenders_file_for_validation_is_for_that(
    tmp_path: Path, kinds: tuple[str, ...], split: Split, expected: tuple[str, str]
) -> None:
    letters = {"train": "abc", "test": "de", "val": "f"}
    scene = load_scene(write_parts(tmp_path, {k: letters[k] for k in ("train", *kinds)}), split)
    assert parts(scene) == expected
    assert scene.account.split.startswith("transforms_train.json and its ")


@pytest.mark.parametrize(("split", "expected"), [("every8", "de"), ("validation", "de")])
def test_photos_of_the_test_listed_for_validation_too_are_used_once(
    tmp_path: Path, split: Split, expected: str
) -> None:
    write_parts(tmp_path, {"train": "abc", "test": "de", "val": "de"})
    scene = load_scene(tmp_path, split)
    assert parts(scene) == ("abc", expected) and len(scene.views) == 5
    assert "2 photos are listed twice (d.png, e.png): each is used once" in scene.notes


def test_a_photo_of_two_poses_is_refused(tmp_path: Path) -> None:
    write_parts(tmp_path, {"train": "abc", "test": "de", "val": "d"})
    values = {"camera_angle_x": 0.7, "frames": [frame("d.png", 7)]}
    (tmp_path / "transforms_val.json").write_text(json.dumps(values))
    with pytest.raises(SceneError, match=r"image d\.png: found it twice"):
        load_scene(tmp_path)


def test_far_views_are_in_no_part() -> None:
    lists = SplitLists("lists", frozenset("ab"), frozenset("cd"))
    assert lists.divide("abcd", [0, 2, 3], "every8")[:2] == ((0,), (2, 3))
