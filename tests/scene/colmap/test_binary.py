"""Hostile bytes in COLMAP's binary layout."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.binary import read_binary, write_binary
from gsynopsis.scene.colmap.model import MODEL_NAMES, SparseModel
from tests.scene.tiny_models import tiny_model

NAMES = ("cameras", "images", "points3D")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_binary(tmp_path, tiny_model(("one.png", "sub/two.x.png")))
    return tmp_path


def with_lists(folder: Path) -> SparseModel:
    """The model in the folder, written again with two observations and tracks of three."""
    model = read_binary(folder)
    images = [struct.pack("<Q", len(model.images))]
    for number, image in enumerate(model.images):
        images.append(struct.pack("<i7di", number, *image.quaternion, *image.translation, 1))
        images.append(image.name.encode() + b"\0" + struct.pack("<Q", 2))
        images.append(struct.pack("<ddqddq", 1.5, 2.5, 1, 3.5, 4.5, -1))
    points = [struct.pack("<Q", len(model.points))]
    for number, (xyz, rgb) in enumerate(zip(model.points, model.colors, strict=True)):
        points.append(struct.pack("<Q3d3BdQ", number, *xyz, *rgb, 0.5, 3))
        points.append(struct.pack("<6i", 1, 0, 2, 0, 2, 1))
    (folder / "images.bin").write_bytes(b"".join(images))
    (folder / "points3D.bin").write_bytes(b"".join(points))
    return model


def test_what_is_written_is_what_is_read(folder):
    model, found = tiny_model(("one.png", "sub/two.x.png")), read_binary(folder)
    assert found.cameras == model.cameras
    assert [image.name for image in found.images] == ["one.png", "sub/two.x.png"]
    np.testing.assert_array_equal(found.points, model.points)
    np.testing.assert_array_equal(found.colors, model.colors)


def test_observations_and_tracks_change_nothing(folder):
    model = with_lists(folder)
    found = read_binary(folder)
    assert found.images == model.images
    np.testing.assert_array_equal(found.points, model.points)
    np.testing.assert_array_equal(found.colors, model.colors)


@pytest.mark.parametrize("lists", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_every_truncation_is_refused_by_name(folder, name, lists):
    if lists:
        with_lists(folder)
    path = folder / f"{name}.bin"
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(SceneError, match=rf"{name}\.bin: .* at byte \d+: found \d+ bytes, exp"):
            read_binary(folder)


@pytest.mark.parametrize("name", NAMES)
def test_one_byte_too_many_is_refused(folder, name):
    path = folder / f"{name}.bin"
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(SceneError, match=rf"{name}\.bin: end of records .* found 1 more bytes"):
        read_binary(folder)


@pytest.mark.parametrize("count", [1000, 2**40, 2**64 - 1])
@pytest.mark.parametrize("name", NAMES)
def test_a_count_that_cannot_be_is_refused_before_anything_is_allocated(folder, name, count):
    path = folder / f"{name}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    with pytest.raises(SceneError, match=f"{count} {name.removesuffix('3D')} at byte 8: found"):
        read_binary(folder)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(name=st.sampled_from(NAMES), place=st.integers(0, 10_000), value=st.integers(1, 255))
def test_a_changed_byte_is_read_or_refused_but_never_a_crash(folder, name, place, value):
    with_lists(folder)
    path = folder / f"{name}.bin"
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= value
    path.write_bytes(data)
    try:
        found = read_binary(folder)
    except SceneError as error:
        assert str(path.parent) in str(error) and "\n" not in str(error)
    else:
        assert all(0 < c.fx < np.inf for c in found.cameras.values())
    finally:
        write_binary(folder, tiny_model(("one.png", "sub/two.x.png")))


@pytest.mark.parametrize(
    ("place", "layout", "value", "words"),
    [
        (12, "<i", 99, "camera 1 model: found number 99"),
        (12, "<i", -1, "camera 1 model: found number -1"),
        (12, "<i", MODEL_NAMES.index("EUCM"), "camera 1 model: found EUCM"),
        (16, "<Q", 0, "camera 1 size: found 0x10, expected 1 to 65536"),
        (24, "<Q", 2**40, "camera 1 size: found 12x1099511627776"),
        (32, "<d", -1.0, "camera 1 parameters: found"),
        (40, "<d", float("nan"), "camera 1 parameters: found"),
        (48, "<d", float("inf"), "camera 1 parameters: found"),
    ],
)
def test_an_impossible_camera_is_refused(folder, place, layout, value, words):
    path = folder / "cameras.bin"
    data = bytearray(path.read_bytes())
    struct.pack_into(layout, data, place, value)
    path.write_bytes(data)
    with pytest.raises(SceneError, match=words):
        read_binary(folder)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (44, -1e20, "image one.png pose: found .*-1e.20.*, expected finite numbers below"),
        (12, 2.0, "image one.png pose: found a quaternion of length 2, expected length 1"),
        (12, 0.0, "image one.png pose: found a quaternion of length 0, expected length 1"),
    ],
)
def test_a_pose_that_is_not_rigid_is_refused(folder, place, value, words):
    path = folder / "images.bin"
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, place, value)
    path.write_bytes(data)
    with pytest.raises(SceneError, match=words):
        read_binary(folder)


@pytest.mark.parametrize(("place", "value"), [(12, float("nan")), (44, float("-inf"))])
def test_an_image_whose_pose_is_not_finite_is_left_out_and_named(folder, place, value):
    path = folder / "images.bin"
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, place, value)
    path.write_bytes(data)
    found = read_binary(folder)
    assert [image.name for image in found.images] == ["sub/two.x.png"]
    assert found.lost == ("one.png",)


def test_a_name_that_is_not_text_is_refused(folder):
    path = folder / "images.bin"
    path.write_bytes(path.read_bytes().replace(b"one.png", b"\xff\xfe.png"))
    with pytest.raises(SceneError, match=r"image 0 name: found b'.*', expected UTF-8"):
        read_binary(folder)
