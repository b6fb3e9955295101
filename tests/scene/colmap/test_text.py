"""COLMAP's text layout: truncations, hand-made files, odd names."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.text import read_text
from tests.scene.tiny_models import tiny_model

NAMES = ("cameras", "images", "points3D")
HAND = {
    "cameras": "1 PINHOLE 12 10 11 10.5 5.5 5.25",
    "images": "1 1 0 0 0 0 0 2 1 a photo.one.png\n\n2 1 0 0 0 1 0 2 1 b.png\n1 2 3 4 5 -1",
    "points3D": "1 0 1 2 255 0 9 0.5\n2 1 1 1 1 2 3 0.5 1 0 2 1",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_binary(tmp_path / "bin", tiny_model(("one.png", "sub/two.x.png")))
    (tmp_path / "txt").mkdir()
    pycolmap.Reconstruction(tmp_path / "bin").write_text(tmp_path / "txt")
    return tmp_path / "txt"


def hand_made(folder: Path, **changed: str) -> Path:
    for name, text in (HAND | changed).items():
        (folder / f"{name}.txt").write_text(text)
    return folder


def test_text_written_by_colmap_reads_like_its_binary(folder):
    model, found = tiny_model(("one.png", "sub/two.x.png")), read_text(folder)
    assert found.cameras == model.cameras
    assert sorted(image.name for image in found.images) == ["one.png", "sub/two.x.png"]
    order = np.lexsort(found.points.T), np.lexsort(model.points.T)
    np.testing.assert_allclose(found.points[order[0]], model.points[order[1]], atol=1e-14)
    np.testing.assert_array_equal(found.colors[order[0]], model.colors[order[1]])


@pytest.mark.parametrize("name", NAMES)
def test_every_truncation_within_the_data_is_refused_by_name(folder, name):
    path = folder / f"{name}.txt"
    whole = path.read_bytes()
    start = whole.index(b"Number of") + 30
    for size in range(start, len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(SceneError, match=rf"{name}\.txt"):
            read_text(folder)


def test_a_file_made_by_hand_needs_no_comments_and_no_last_line_end(tmp_path):
    model = read_text(hand_made(tmp_path))
    assert [image.name for image in model.images] == ["a photo.one.png", "b.png"]
    np.testing.assert_array_equal(model.points, [[0, 1, 2], [1, 1, 1]])
    np.testing.assert_array_equal(model.colors, [[255, 0, 9], [1, 2, 3]])


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("cameras", "1 PINHOLE 12", "line 1: camera: found 3 words, expected at least 4"),
        ("cameras", "1 PINHOLE 12 10 11 10", "camera 1 parameters: found 2, expected 4"),
        ("cameras", "1 PINHOLE 12 ten 11 10 5 5", "camera 1 size: found 12 ten, expected num"),
        ("cameras", "1 FISHEYE 12 10 11 10 5 5", "model: found FISHEYE, expected one of"),
        ("images", "1 1 0 0 0 0 0 2 1", "line 1: image: found 9 words, expected 10"),
        ("images", "1 1 0 0 0 0 1e20 2 1 a.png", "a.png pose: found .*1e.20.*expected finite"),
        ("images", "1 1 0 0 x 0 0 2 1 a.png", "line 1: image a.png pose: found .*expected num"),
        ("images", "1 1 0 0 0 0 0 2 1 a.png\n1 2", "line 2: image a.png observations: found 2"),
        ("points3D", "1 0 1 2 255 0", "line 1: point: found 6 words"),
        ("points3D", "1 0 1 2 255 0 0 0.5 7", "line 1: point: found 9 words"),
        ("points3D", "1 0 1 2 256 0 0 0.5", r"point rgb: found \[256, 0, 0\], expected 0 to 255"),
    ],
)
def test_a_broken_line_is_named_with_its_number(tmp_path, file, text, words):
    with pytest.raises(SceneError, match=words):
        read_text(hand_made(tmp_path, **{file: text}))


def test_bytes_that_are_not_text_are_refused(tmp_path):
    hand_made(tmp_path)
    (tmp_path / "points3D.txt").write_bytes(b"1 2 \xff\xfe")
    with pytest.raises(SceneError, match=r"points3D\.txt: found a byte that is not UTF-8 at 4"):
        read_text(tmp_path)


POSED = "1 0 0 0 0.1 0.2 {x} 1"


def names_of(folder: Path, images: str, encoding: str = "utf-8") -> list[str]:
    hand_made(folder)
    (folder / "images.txt").write_bytes(images.encode(encoding))
    return [image.name for image in read_text(folder).images]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("words", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("second", [[], [""], ["3 4 -1 5.5 6.5 7"], ["", ""]])
def test_names_of_any_number_of_words_with_and_without_second_lines(tmp_path, words, second, end):
    names = [" ".join(["1", "2", "(3)", "a", "b", f"{n}.jpg"][-words:]) for n in range(8)]
    lines = ["# a comment"]
    for number, name in enumerate(names):
        lines += [f"{number + 1} {POSED.format(x=number)} {name}", *second]
        lines += ["# another"] if number == 3 else []
    assert names_of(tmp_path, end.join(lines) + end) == names
    assert names_of(tmp_path, end.join(lines)) == names


def test_names_of_numbers_alone_are_no_observations(tmp_path):
    names = [f"2024 07 {n}" for n in range(8)]
    lines = [f"{n} {POSED.format(x=n)} {name}" for n, name in enumerate(names)]
    assert names_of(tmp_path, "\n".join(lines)) == names


def test_some_images_may_lack_their_second_line(tmp_path):
    a, b, c = (f"{n} {POSED.format(x=n)} {name}" for n, name in enumerate(("a", "b c d", "e f g")))
    assert names_of(tmp_path, f"{a}\n1 2 -1\n{b}\n{c}\n\n") == ["a", "b c d", "e f g"]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks_of_windows_are_passed_over(tmp_path, encoding):
    images = f"# Zürich\n1 {POSED.format(x=0)} Zürich.jpg\n\n"
    assert names_of(tmp_path, images, encoding) == ["Zürich.jpg"]


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "-1.#IND", "inf"])
def test_an_image_of_text_whose_pose_is_not_finite_is_left_out_and_named(tmp_path, word):
    lines = [f"{n} {POSED.format(x=word if n == 1 else n)} {n} x y.jpg" for n in range(3)]
    assert names_of(tmp_path, "\n".join(lines)) == ["0 x y.jpg", "2 x y.jpg"]
    assert read_text(tmp_path).lost == ("1 x y.jpg",)


def test_decimal_commas_whole_floats_and_rounded_rotations_are_read(tmp_path):
    model = read_text(
        hand_made(
            tmp_path,
            cameras="1 PINHOLE 12.0 1e1 11,5 10,5 5,5 5,25",
            images="1,0 0,71 0,71 0 0 0,5 0 2 1.0 a.png",
            points3D="1 0,5 1 2 255.0 0 9 0,5",
        )
    )
    assert (model.cameras[1].width, model.cameras[1].fx) == (12, 11.5)
    assert model.images[0].quaternion == pytest.approx((0.5**0.5, 0.5**0.5, 0, 0))
    assert model.points.tolist() == [[0.5, 1, 2]] and model.colors.tolist() == [[255, 0, 9]]
    assert [note.partition(" ")[0] for note in model.notes] == [
        "cameras.txt",
        "images.txt",
        "points3D.txt",
    ]


def test_a_comment_that_says_too_few_is_noted_and_one_that_says_too_many_is_refused(tmp_path):
    hand_made(tmp_path, points3D=f"# Number of points: 1\n{HAND['points3D']}\n")
    model = read_text(tmp_path)
    assert len(model.points) == 2
    assert model.notes == ("points3D.txt has 2 points, its comment says 1: all read",)
    hand_made(tmp_path, points3D=f"# Number of points: 3\n{HAND['points3D']}\n")
    with pytest.raises(SceneError, match=r"points: found 2, expected 3; .* take out the comment"):
        read_text(tmp_path)
    hand_made(tmp_path)
    assert len(read_text(tmp_path).points) == 2
