"""COLMAP models against pycolmap, in both layouts."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.model import MODEL_NAMES
from gsynopsis.scene.colmap.read import find_sparse, read_colmap, read_sparse
from gsynopsis.scene.load import load_scene


def as_text(folder: Path, out: Path) -> Path:
    """The same model in COLMAP's own text."""
    out.mkdir()
    pycolmap.Reconstruction(folder).write_text(out)
    return out


@pytest.mark.parametrize("name", ["fox", "brighton", "bonsai"])
def test_cameras_and_points_of_real_scenes_are_those_of_pycolmap(real_scene, name):
    root = real_scene(name)
    ours, theirs = load_scene(root), pycolmap.Reconstruction(root / "sparse" / "0")
    images = sorted(theirs.images.values(), key=lambda image: image.name)
    assert [view.name for view in ours.views] == [image.name for image in images]
    for view, image in zip(ours.views, images, strict=True):
        lens = theirs.cameras[image.camera_id]
        c = view.camera
        assert (c.width, c.height) == (lens.width, lens.height)
        assert [c.fx, c.fy, c.cx, c.cy] == list(lens.params)
        np.testing.assert_allclose(c.w2c[:3], image.cam_from_world().matrix(), atol=1e-14)
        np.testing.assert_allclose(c.position, image.projection_center(), atol=1e-12)
    points = [theirs.points3D[key] for key in theirs.points3D]
    rows = {(*p.xyz.tolist(), *p.color.tolist()) for p in points}
    mine = zip(ours.points.tolist(), ours.colors.tolist(), strict=True)
    assert rows == {(*xyz, *rgb) for xyz, rgb in mine}
    assert len(points) == len(ours.points)


def test_a_pixel_of_an_observed_point_is_where_the_camera_projects_it(real_scene):
    root = real_scene("brighton")
    theirs = pycolmap.Reconstruction(root / "sparse" / "0")
    errors: list[list[float]] = []
    for view in load_scene(root).views:
        seen = [p for p in theirs.find_image_with_name(view.name).points2D if p.has_point3D()]
        world = np.array([theirs.points3D[p.point3D_id].xyz for p in seen])
        x, y, z = view.camera.w2c[:3, :3] @ world.T + view.camera.w2c[:3, 3:]
        c = view.camera
        pixels = np.stack([c.fx * x / z + c.cx, c.fy * y / z + c.cy], axis=1)
        errors += (pixels - [p.xy for p in seen]).tolist()
    # Measured: 0.25 px, in all directions alike. A wrong pixel centre would shift them by 0.5.
    assert np.linalg.norm(errors, axis=1).mean() < 0.3
    np.testing.assert_allclose(np.mean(errors, axis=0), 0, atol=0.01)


@pytest.mark.parametrize("name", ["brighton", "bonsai"])
def test_text_and_binary_of_a_real_scene_read_alike(real_scene, tmp_path, name):
    binary = real_scene(name) / "sparse" / "0"
    one, two = read_sparse(binary), read_sparse(as_text(binary, tmp_path / "txt"))
    assert one.cameras == two.cameras
    left = sorted(one.images, key=lambda image: image.name)
    right = sorted(two.images, key=lambda image: image.name)
    for a, b in zip(left, right, strict=True):
        assert (a.name, a.camera) == (b.name, b.camera)
        np.testing.assert_allclose(a.quaternion, b.quaternion, atol=1e-14)
        np.testing.assert_allclose(a.translation, b.translation, atol=1e-14)
    np.testing.assert_allclose(
        one.points[np.lexsort(one.points.T)], two.points[np.lexsort(two.points.T)], atol=1e-12
    )
    assert one.colors.sum() == two.colors.sum()


def test_pycolmap_reads_what_is_written(tiny, tmp_path):
    model = read_sparse(tiny() / "sparse" / "0")
    write_binary(tmp_path / "again", model)
    theirs = pycolmap.Reconstruction(tmp_path / "again")
    assert {image.name for image in theirs.images.values()} == {"a.png", "b.png", "c.png"}
    for image in model.images:
        found = theirs.find_image_with_name(image.name).cam_from_world()
        np.testing.assert_allclose(found.rotation.quat, np.roll(image.quaternion, -1), atol=1e-15)
        np.testing.assert_array_equal(found.translation, image.translation)
    xyz = np.array([theirs.points3D[i + 1].xyz for i in range(len(model.points))])
    np.testing.assert_array_equal(xyz, model.points)


def test_camera_models_have_the_names_and_numbers_of_colmap():
    theirs = {
        value: name for name, value in pycolmap.CameraModelId.__members__.items() if int(value) >= 0
    }
    assert dict(enumerate(MODEL_NAMES)) == {int(k): name for k, name in theirs.items()}


def test_a_model_right_in_the_sparse_folder_is_found(tiny):
    root = tiny()
    for path in (root / "sparse" / "0").iterdir():
        path.rename(root / "sparse" / path.name)
    assert find_sparse(root) == root / "sparse"
    assert len(load_scene(root).views) == 3


def test_rigs_and_frames_beside_the_model_are_ignored(tiny, tmp_path):
    root = tiny()
    sparse = root / "sparse" / "0"
    pycolmap.Reconstruction(sparse).write_binary(sparse)
    assert (sparse / "rigs.bin").exists() and (sparse / "frames.bin").exists()
    assert len(load_scene(root).views) == 3


def test_a_simple_pinhole_camera_has_one_focal_length(tiny, tmp_path):
    root = tiny()
    sparse = as_text(root / "sparse" / "0", tmp_path / "txt")
    (sparse / "cameras.txt").write_text("1 SIMPLE_PINHOLE 12 10 9.5 6.25 4.75\n")
    camera = read_colmap(root, sparse).views[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (9.5, 9.5, 6.25, 4.75)


@pytest.mark.parametrize("model", ["EUCM", "SIMPLE_DIVISION", "FISHEYE"])
@pytest.mark.parametrize("text", [False, True])
def test_a_model_that_cannot_be_read_is_refused_with_the_command_that_helps(tiny, model, text):
    root = tiny()
    sparse = root / "sparse" / "0"
    theirs = pycolmap.Reconstruction(sparse)
    theirs.cameras[1].model = pycolmap.CameraModelId.__members__[model]
    theirs.cameras[1].params = np.full(len(theirs.cameras[1].params_info.split(",")), 5.0)
    if text:
        for path in sparse.iterdir():
            path.unlink()
        theirs.write_text(sparse)
    else:
        theirs.write_binary(sparse)
    with pytest.raises(SceneError) as caught:
        load_scene(root)
    message = str(caught.value)
    assert f"found {model}, expected one of SIMPLE_PINHOLE, PINHOLE, " in message
    assert f"colmap image_undistorter --image_path {root}/images" in message
    assert f"--input_path {root}/sparse/0 --output_path" in message
    assert "--output_type COLMAP" in message and "\n" not in message


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_missing_file_is_named(tiny, name):
    root = tiny()
    (root / "sparse" / "0" / name).unlink()
    with pytest.raises(SceneError, match=f"{name}: found no such file"):
        load_scene(root)


def test_an_image_of_an_unknown_camera_is_refused(tiny, tmp_path):
    root = tiny()
    sparse = as_text(root / "sparse" / "0", tmp_path / "txt")
    cameras = (sparse / "cameras.txt").read_text()
    (sparse / "cameras.txt").write_text(cameras.replace("\n1 PINHOLE", "\n8 PINHOLE"))
    with pytest.raises(SceneError, match=r"image .* camera: found 1, expected a camera of cameras"):
        read_colmap(root, sparse)


def test_a_scene_without_its_folder_of_images_is_refused(tiny):
    root = tiny()
    (root / "images").rename(root / "photos")
    with pytest.raises(SceneError, match="images: found no such folder"):
        load_scene(root)
