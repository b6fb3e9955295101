"""Panoramas of the whole sphere are taken, others refused; photos of their shape are neither."""

import json
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.capture.photo_set import gather
from gsynopsis.errors import SceneError
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.panoramas import FOCAL, FOCAL_35
from tests.scene.films import FFMPEG, needs_ffmpeg

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-'
    'syntax-ns#"><rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {}'
    "</rdf:RDF></x:xmpmeta>"
)
ATTRIBUTE = XMP.format('GPano:ProjectionType="equirectangular"/>')
ELEMENT = XMP.format("><GPano:ProjectionType>cylindrical</GPano:ProjectionType></rdf:Description>")


def wall(seed: int, width: int, height: int, *, around: bool = False) -> Image.Image:
    """A smooth picture; `around`: its right side goes on at its left one."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 256, (4, 8, 3)).astype(np.uint8)
    if around:
        cells = np.concatenate([cells, cells, cells], axis=1)
        picture = Image.fromarray(cells).resize((3 * width, height), Image.Resampling.BICUBIC)
        return picture.crop((width, 0, 2 * width, height))
    cells[:, 0], cells[:, -1] = 20, 230
    return Image.fromarray(cells).resize((width, height), Image.Resampling.BICUBIC)


def ordinary(root: Path, count: int = 3) -> Path:
    for number in range(count):
        wall(number, 96, 64).save(root / f"{number}.jpg")
    return root


@pytest.mark.parametrize("size", [(256, 128), (257, 128), (6080, 3040)])
def test_photos_of_a_sphere_are_known_and_taken(tmp_path: Path, size: tuple[int, int]) -> None:
    for number in range(3):
        wall(number, *size, around=True).save(tmp_path / f"{number}.jpg")
    assert all(photo.sphere for photo in gather(tmp_path).photos)


def test_photos_of_its_shape_that_do_not_meet_are_refused_with_a_command_that_cuts_them(
    tmp_path: Path,
) -> None:
    for number in range(3):
        wall(number, 256, 128).save(tmp_path / f"{number}.jpg")
    with pytest.raises(SceneError, match=r"found 3 of 3 photos that are or look like panor") as e:
        gather(tmp_path)
    assert "\n" not in str(e.value) and "0.jpg, 1.jpg, 2.jpg" in str(e.value)


@pytest.mark.parametrize("xmp", [ATTRIBUTE, ELEMENT])
@pytest.mark.parametrize(("kind", "size"), [("jpg", (300, 100)), ("png", (96, 64))])
def test_one_among_other_photos_that_says_so_is_named(
    tmp_path: Path, xmp: str, kind: str, size: tuple[int, int]
) -> None:
    ordinary(tmp_path)
    path = tmp_path / f"all.{kind}"
    if kind == "jpg":
        wall(9, *size).save(path, xmp=xmp.encode())
    else:
        from PIL.PngImagePlugin import PngInfo

        info = PngInfo()
        info.add_itxt("XML:com.adobe.xmp", xmp)
        wall(9, *size).save(path, pnginfo=info)
    with pytest.raises(SceneError, match=rf"found 1 of 4 photos .*\(all\.{kind}\).*cut each into"):
        gather(tmp_path)


def test_a_sweep_of_a_phone_says_so_too(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA401] = 6
    wall(9, 400, 90).save(ordinary(tmp_path) / "sweep.jpg", exif=exif)
    with pytest.raises(SceneError, match=r"found 1 of 4 photos .*\(sweep\.jpg\)"):
        gather(tmp_path)


@pytest.mark.parametrize("tag", [FOCAL, FOCAL_35])
def test_photos_of_that_shape_with_a_lens_and_sides_apart_are_none(
    tmp_path: Path, tag: int
) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[tag] = 26
    for number in range(3):
        wall(number, 256, 128).save(tmp_path / f"{number}.jpg", exif=exif)
    assert len(gather(tmp_path).photos) == 3
    wall(3, 256, 128, around=True).save(tmp_path / "around.jpg", exif=exif)
    assert [p.name for p in gather(tmp_path).photos if p.panorama and p.sphere] == ["around.jpg"]


def test_frames_of_a_wide_video_are_photos_and_those_of_a_sphere_are_cut(tmp_path: Path) -> None:
    for number in range(5):
        wall(number, 256, 128, around=number == 0).save(tmp_path / f"{number}.jpg")
    photos = gather(tmp_path, filmed=True).photos
    assert len(photos) == 5 and not any(photo.panorama for photo in photos)
    for number in range(1, 4):
        wall(number, 256, 128, around=True).save(tmp_path / f"{number}.jpg")
    photos = gather(tmp_path, filmed=True).photos
    assert sum(photo.panorama and photo.sphere for photo in photos) == 4


@pytest.mark.parametrize(
    "model", ["CYLINDRICAL", "VR180_L", "panoramic", "OMNIDIRECTIONALSTEREO_L"]
)
def test_frames_of_half_spheres_are_refused(tmp_path: Path, model: str) -> None:
    wall(0, 96, 48).save(tmp_path / "a.png")
    pose = np.eye(4).tolist()
    plain = {"file_path": "a.png", "transform_matrix": pose, "fl_x": 50}
    for top, frame in (({"camera_model": model}, plain), ({}, plain | {"camera_model": model})):
        values = {**top, "frames": [plain, frame]}
        (tmp_path / "transforms.json").write_text(json.dumps(values))
        with pytest.raises(SceneError, match=rf"camera_model: found '{model}'.*cut each") as e:
            load_scene(tmp_path)
        assert "image_undistorter" not in str(e.value)


def test_a_list_of_camera_models_is_one_line(tmp_path: Path) -> None:
    wall(0, 96, 48).save(tmp_path / "a.png")
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
    values = {"camera_model": ["OPENCV"], "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(SceneError, match=r"camera_model: found \['OPENCV'\], expected one of"):
        load_scene(tmp_path)


@needs_ffmpeg
def test_the_command_of_the_advice_cuts_a_panorama_into_photos_that_are_read(
    tmp_path: Path,
) -> None:
    wall(0, 512, 256, around=True).save(tmp_path / "P.jpg")
    for number in range(3):
        wall(number, 512, 256).save(tmp_path / f"{number}.jpg")
    with pytest.raises(SceneError) as caught:
        gather(tmp_path)
    match = re.search(r"with (ffmpeg .*?\.jpg) and so on", str(caught.value))
    assert match is not None
    for path in tmp_path.glob("[0-9].jpg"):
        path.unlink()
    for yaw in (0, 60, 120):
        words = shlex.split(match[1].replace("yaw=0", f"yaw={yaw}").replace("P_0", f"P_{yaw}"))
        line = [str(FFMPEG), "-loglevel", "error", *words[1:]]
        subprocess.run(line, cwd=tmp_path, check=True, timeout=60)
    (tmp_path / "P.jpg").unlink()
    sizes = [photo.size for photo in gather(tmp_path).photos]
    assert sizes == [(1024, 1024)] * 3
