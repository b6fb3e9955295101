"""Lenses bend as COLMAP's do, and photos become what a pinhole camera sees."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.binary import read_binary
from gsynopsis.scene.colmap.distortion import PARAMS, Lens, Warp, lens_of, warp_of
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.photos import PhotoForm, load_photo
from gsynopsis.scene.stored import ORIENTATION

pycolmap = pytest.importorskip("pycolmap")
SIZE = (640, 480)
CAMERAS = {
    "SIMPLE_PINHOLE": (500, 320, 240),
    "PINHOLE": (500, 510, 320, 240),
    "SIMPLE_RADIAL": (500, 320, 240, -0.1),
    "RADIAL": (500, 320, 240, 0.1, -0.02),
    "OPENCV": (500, 510, 320, 240, -0.1, 0.02, 0.001, -0.002),
    "OPENCV_FISHEYE": (300, 310, 320, 240, -0.02, 0.01, 0.001, -0.0002),
    "FULL_OPENCV": (500, 510, 320, 240, 0.3, 0.02, 0.001, -0.002, 0.01, 0.35, 0.01, 0.02),
    "FOV": (500, 510, 320, 240, 0.9),
    "SIMPLE_RADIAL_FISHEYE": (300, 320, 240, 0.03),
    "RADIAL_FISHEYE": (300, 320, 240, 0.03, -0.01),
    "THIN_PRISM_FISHEYE": (
        *(300, 310, 320, 240, 0.01, 0.002),
        *(0.001, -0.002, 0.001, 0.0001, 0.002, -0.001),
    ),
}


@pytest.mark.parametrize("model", PARAMS)
def test_every_model_projects_as_colmap_does_and_back(model: str, rng) -> None:
    params = CAMERAS[model]
    theirs = pycolmap.Camera.create_from_model_name(1, model, 500.0, *SIZE)
    theirs.params = np.array(params, np.float64)
    plane = rng.uniform(-0.6, 0.6, (50, 2))
    (fx, fy, cx, cy), lens = lens_of(model, params)
    bent = lens.distorted(plane)
    wanted = theirs.img_from_cam(np.hstack([plane, np.ones((50, 1))]))
    assert bent * (fx, fy) + (cx, cy) == pytest.approx(wanted, abs=1e-9)
    back, good = lens.undistorted(bent)
    assert good.all() and back == pytest.approx(plane, abs=1e-8)


@pytest.mark.parametrize("model", [m for m in PARAMS if not m.endswith("PINHOLE")])
def test_the_pinhole_image_shows_nothing_beyond_the_photo_and_nearly_all_of_it(model: str) -> None:
    (fx, fy, cx, cy), lens = lens_of(model, CAMERAS[model])
    warp = warp_of(Path("cameras.bin"), "camera 1", lens, SIZE, (fx, fy, cx, cy))
    assert warp is not None and warp.pinhole[2:4] == (fx, fy)
    width, height = warp.pinhole[:2]
    steps = np.linspace(0, 1, 50)
    border = [(x * width, y * height) for x in steps for y in steps if {x, y} & {0.0, 1.0}]
    places = warp.source(np.array(border))
    assert (places > -0.01).all() and (places < np.array(SIZE) + 0.01).all()
    assert (places.max(axis=0) - places.min(axis=0) > 0.93 * np.array(SIZE)).all()


def test_a_straight_lens_needs_no_warp_and_one_that_folds_is_refused() -> None:
    intrinsics = (500.0, 500.0, 320.0, 240.0)
    assert warp_of(Path("c"), "camera 1", Lens(radial=(0.0,)), SIZE, intrinsics) is None
    with pytest.raises(SceneError, match=r"^c: camera 1 distortion: found a lens that folds over"):
        warp_of(Path("c"), "camera 1", Lens(radial=(-3.0,)), SIZE, intrinsics)
    with pytest.raises(SceneError, match="--lens SIMPLE_RADIAL"):
        warp_of(Path("c"), "camera 1", Lens(radial=(float("1e9"),) * 4), SIZE, intrinsics)


def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth picture that is known everywhere, [H, W]."""
    return 128 + 60 * np.sin(x / 37) * np.cos(y / 31) + 0.1 * x


def bent_photo(path: Path, warp: Warp) -> None:
    """What a camera with this lens takes of a scene whose pinhole image is `waves`."""
    width, height = warp.size
    grid = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    _, _, fx, fy, cx, cy = warp.photo
    plane, good = warp.lens.undistorted((grid.reshape(-1, 2) - (cx, cy)) / (fx, fy))
    assert good.all()
    _, _, fx, fy, cx, cy = warp.pinhole
    x, y = (plane * (fx, fy) + (cx, cy)).T
    pixels = waves(x, y).reshape(height, width).clip(0, 255).round().astype(np.uint8)
    Image.fromarray(np.repeat(pixels[:, :, None], 3, axis=2)).save(path)


@pytest.mark.parametrize("model", ["OPENCV", "FOV", "OPENCV_FISHEYE"])
def test_a_photo_is_resampled_to_what_the_pinhole_camera_sees(model: str, tmp_path: Path) -> None:
    intrinsics, lens = lens_of(model, CAMERAS[model])
    warp = warp_of(Path("c"), "camera 1", lens, SIZE, intrinsics)
    assert warp is not None
    bent_photo(tmp_path / "a.png", warp)
    image = load_photo(tmp_path / "a.png", 1, form=PhotoForm(warp=warp))
    width, height = warp.pinhole[:2]
    assert image.shape == (height, width, 3)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    off = np.abs(image[:, :, 0] - waves(x, y).clip(0, 255))[2:-2, 2:-2]
    # Rounding to 8 bits twice.
    assert off.max() < 2.0 and off.mean() < 0.4


@pytest.mark.parametrize("model", ["OPENCV", "SIMPLE_RADIAL", "OPENCV_FISHEYE"])
def test_a_colmap_model_with_distortion_is_read_as_pinhole_cameras(tiny, model: str) -> None:
    root = tiny()
    theirs = pycolmap.Reconstruction(root / "sparse" / "0")
    theirs.cameras[1].model = pycolmap.CameraModelId.__members__[model]
    extra = {"OPENCV": (-0.02, 0.0, 0.0, 0.0), "SIMPLE_RADIAL": (-0.02,)}.get(model, (0.0,) * 4)
    focal = (11.0,) if model == "SIMPLE_RADIAL" else (11.0, 10.5)
    theirs.cameras[1].params = np.array([*focal, 5.5, 5.25, *extra])
    theirs.write_binary(root / "sparse" / "0")
    scene = load_scene(root)
    for view in range(3):
        camera = scene.camera(view)
        assert scene.image(view).shape == (camera.height, camera.width, 3)
        assert scene.image(view, 2).shape[0] == scene.camera(view, 2).height
        assert camera.fx == 11.0 and scene.views[view].stored_size == (12, 10)


@pytest.mark.parametrize("strength", [-3.0, 1e9, float("nan")])
def test_a_lens_that_folds_over_is_one_line_with_what_to_do(tiny, strength: float) -> None:
    root = tiny()
    theirs = pycolmap.Reconstruction(root / "sparse" / "0")
    theirs.cameras[1].model = pycolmap.CameraModelId.SIMPLE_RADIAL
    theirs.cameras[1].params = np.array([11.0, 5.5, 5.25, strength])
    theirs.write_binary(root / "sparse" / "0")
    with pytest.raises(SceneError) as refused:
        load_scene(root)
    (line,) = str(refused.value).splitlines()
    assert "cameras.bin: camera 1" in line
    if np.isfinite(strength):
        assert "distortion: found a lens that folds over within the photo" in line
        assert line.endswith("gsynopsis scene PHOTOS OUT --lens SIMPLE_RADIAL")


def test_photos_of_several_sizes_and_a_turned_one_fit_their_cameras(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png", "d.png"))
    upright = load_scene(root).image(2)
    images = root / "images"
    Image.open(images / "b.png").resize((24, 20)).save(images / "b.png")
    turned = Image.open(images / "c.png").transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    turned.save(images / "c.png", exif=exif)
    scene = load_scene(root)
    assert (scene.camera(1).width, scene.camera(1).fx) == (24, 22.0)
    assert np.array_equal(scene.image(2), upright)
    assert scene.views[2].stored_size == (10, 12)
    Image.new("RGB", (12, 12)).save(images / "d.png")
    with pytest.raises(SceneError, match=r"d\.png: image size: found 12x12, expected 12x10"):
        load_scene(root)


def test_a_transforms_file_with_distortion_is_the_colmap_scene_with_it(tiny, tmp_path) -> None:
    root = tiny()
    model = read_binary(root / "sparse" / "0")
    lens = dataclasses.replace(model.cameras[1], lens=Lens(radial=(-0.02, 0.001)))
    colmap = load_scene(root)
    frames = []
    for view in colmap.views:
        c2w = np.linalg.inv(view.camera.w2c) @ np.diag([1, -1, -1, 1])
        frames.append({"file_path": f"images/{view.name}", "transform_matrix": c2w.tolist()})
    values = {"fl_x": lens.fx, "fl_y": lens.fy, "cx": lens.cx, "cy": lens.cy, "w": 12, "h": 10}
    for extra in ({"k1": -0.02, "k2": 0.001}, {"k1": -0.02, "is_fisheye": True}):
        (root / "transforms.json").write_text(json.dumps(values | extra | {"frames": frames}))
        other = root.rename(tmp_path / f"other{len(extra)}{'is_fisheye' in extra}")
        (other / "sparse").rename(tmp_path / "sparse")
        scene = load_scene(other)
        warp = scene.views[0].form.warp
        assert warp is not None and warp.lens.fisheye == ("is_fisheye" in extra)
        assert warp.lens.radial[:2] == (-0.02, extra.get("k2", 0.0))
        (tmp_path / "sparse").rename(other / "sparse")
        root = other
