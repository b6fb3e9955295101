"""Poses of Metashape, OpenSfM and RealityCapture: written by their descriptions, read back."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gsynopsis.errors import NoPosesError
from gsynopsis.scene.camera import world_to_camera
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.distortion import STRAIGHT, Lens
from gsynopsis.scene.colmap.model import Pinhole
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.programs.find import find_program
from gsynopsis.scene.programs.metashape import read_metashape
from gsynopsis.scene.programs.opensfm import read_opensfm
from gsynopsis.scene.programs.posed_photos import PhotosByLabel, PosedPhoto, Poses, records_of
from gsynopsis.scene.programs.realitycapture import read_realitycapture, rotation_of
from tests.scene.tiny_models import tiny_model

SIZE = (48, 32)
NAMES = ("a.jpg", "b c.jpg", "d.jpg")
LENS = Lens(radial=(-0.05, 0.01, 0.002, 0.0), tangential=(0.001, -0.002))
CAMERA = Pinhole(*SIZE, 40.0, 41.0, 24.5, 15.25, LENS)
Write = Callable[[Path, Pinhole, list[PosedPhoto]], None]


def posed(camera: Pinhole = CAMERA, names: tuple[str, ...] = NAMES) -> list[PosedPhoto]:
    rng = np.random.default_rng(4)
    found = []
    for name in names:
        rotation = Rotation.random(rng=rng).as_matrix()
        found.append(PosedPhoto(name, camera, world_to_camera(rotation, rng.normal(size=3))))
    return found


def write_metashape(root: Path, camera: Pinhole, photos: list[PosedPhoto]) -> None:
    """f and b1 in place of two focal lengths, P1 and P2 the other way round."""
    radial, (p1, p2) = camera.lens.radial, camera.lens.tangential
    numbers = {"f": camera.fy, "b1": camera.fx - camera.fy, "p1": p2, "p2": p1}
    numbers |= {"cx": camera.cx - camera.width / 2, "cy": camera.cy - camera.height / 2}
    numbers |= {f"k{n}": value for n, value in enumerate(radial, 1)}
    values = "".join(f"<{name}>{value!r}</{name}>" for name, value in numbers.items())
    size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
    wrong = f'<calibration class="initial">{size}<f>1</f></calibration>'
    kind = "fisheye" if camera.lens.fisheye else "frame"
    sensor = f'<sensor id="7" type="{kind}">{size}{wrong}'
    sensor += f'<calibration class="adjusted">{size}{values}</calibration></sensor>'
    cameras = ""
    for photo in photos:
        c2w = " ".join(repr(float(v)) for v in np.linalg.inv(photo.w2c).flatten())
        label = photo.label.removesuffix(".jpg")
        cameras += f'<camera sensor_id="7" component_id="0" label="{label}">'
        cameras += f"<transform>{c2w}</transform></camera>"
    cameras += '<camera sensor_id="7" label="lost"/>'
    text = f"<sensors>{sensor}</sensors><cameras><group>{cameras}</group></cameras>"
    other = '<chunk label="old"><cameras/></chunk>'
    document = f'<document version="2"><chunk label="A">{text}</chunk>{other}</document>'
    (root / "cameras.xml").write_text(f'<?xml version="1.0"?>\n{document}', "utf-8")


def write_opensfm(root: Path, camera: Pinhole, photos: list[PosedPhoto]) -> None:
    """Lengths in shares of the longer side; of a copy of half the size."""
    longer, half = max(camera.width, camera.height), (camera.width // 2, camera.height // 2)
    k, (p1, p2) = (*camera.lens.radial, 0.0, 0.0, 0.0), camera.lens.tangential
    values = {"projection_type": "brown", "width": half[0], "height": half[1]}
    values |= {"focal_x": camera.fx / longer, "focal_y": camera.fy / longer}
    values |= {"c_x": (camera.cx - camera.width / 2) / longer}
    values |= {"c_y": (camera.cy - camera.height / 2) / longer}
    values |= {"k1": k[0], "k2": k[1], "k3": k[2], "p1": p1, "p2": p2}
    shots = {}
    for photo in photos:
        turn = Rotation.from_matrix(photo.w2c[:3, :3]).as_rotvec().tolist()
        place = {"rotation": turn, "translation": photo.w2c[:3, 3].tolist()}
        shots[photo.label] = {**place, "camera": "v2 x", "capture_time": 0.0}
    points = {"9": {"coordinates": [1, 2, 3], "color": [300.0, 20.4, 0]}}
    every = [{"cameras": {}, "shots": {}}, {"cameras": {"v2 x": values}, "shots": shots}]
    every[1]["points"] = points
    (root / "opensfm").mkdir()
    (root / "opensfm" / "reconstruction.json").write_text(json.dumps(every))


def write_realitycapture(root: Path, camera: Pinhole, photos: list[PosedPhoto]) -> None:
    """Angles of Rz(-heading) Rx(pitch) Ry(roll) of OpenGL's axes; one focal length."""
    longer = max(camera.width, camera.height)
    lines = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for photo in photos:
        c2w = np.linalg.inv(photo.w2c)
        flipped = c2w[:3, :3] * [1, -1, -1]
        heading, pitch, roll = Rotation.from_matrix(flipped).as_euler("ZXY", degrees=True)
        values = [*c2w[:3, 3], -heading, pitch, roll, camera.fx * 36 / longer]
        values += [
            (camera.cx - camera.width / 2) / longer,
            (camera.cy - camera.height / 2) / longer,
        ]
        values += [*camera.lens.radial, *camera.lens.tangential]
        lines.append(",".join([f"D:\\photos\\{photo.label}", *(f"{v:.17g}" for v in values)]))
    (root / "registration.csv").write_text("\n".join(lines) + "\n")


WRITERS: dict[str, tuple[Write, Pinhole]] = {
    "cameras.xml": (write_metashape, CAMERA),
    "opensfm/reconstruction.json": (write_opensfm, CAMERA),
    "registration.csv": (write_realitycapture, replace(CAMERA, fy=CAMERA.fx)),
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "images").mkdir()
    rng = np.random.default_rng(0)
    for name in (*NAMES, "lost.jpg"):
        pixels = rng.integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8)
        Image.fromarray(pixels).save(tmp_path / "images" / name)
    return tmp_path


@pytest.mark.parametrize("source", WRITERS)
def test_cameras_are_those_that_were_written(root: Path, source: str) -> None:
    write, camera = WRITERS[source]
    photos = posed(camera)
    write(root, camera, photos)
    expected = records_of(root, Poses(root / "x", tuple(photos)), PhotosByLabel(root))
    scene = load_scene(root)
    assert [view.name for view in scene.views] == list(NAMES)
    for view, wanted in zip(scene.views, expected.views, strict=True):
        np.testing.assert_allclose(view.camera.w2c, wanted.camera.w2c, atol=1e-9)
        found, true = view.camera, wanted.camera
        assert (found.width, found.height) == (true.width, true.height)
        numbers = [(c.fx, c.fy, c.cx, c.cy) for c in (found, true)]
        assert numbers[0] == pytest.approx(numbers[1], abs=1e-6)
        assert view.form.warp is not None and wanted.form.warp is not None
        lenses = [form.warp.lens for form in (view.form, wanted.form)]
        assert lenses[0].radial[:3] == pytest.approx(lenses[1].radial[:3], abs=1e-12)
        assert lenses[0].tangential == pytest.approx(lenses[1].tangential, abs=1e-12)
    text = scene.account.text()
    assert text.startswith(f"3 of 4 photos used, poses of {source}; 1 without a pose (lost.jpg)")


def test_angles_of_realitycapture_are_those_of_its_own_xmp() -> None:
    """A camera that a user exported as both (Epic's forum, thread 710449)."""
    rotation = [
        *(0.982594073038806, 0.185426733553445, -0.0112166890261935),
        *(-0.032113633044729, 0.11008102707942, -0.993403685341366),
        *(-0.18296885582437, 0.976472781986697, 0.114),
    ]
    found = rotation_of(163.736597399311, 83.4154313461628, 174.386496244756).T
    np.testing.assert_allclose(found, np.reshape(rotation, (3, 3)), atol=2e-4)


def test_fisheye_cameras_of_metashape_are_fisheye(root: Path) -> None:
    camera = replace(CAMERA, lens=Lens(fisheye=True, radial=(0.01, 0.002, 0.0, 0.0)))
    write_metashape(root, camera, posed(camera))
    found = read_metashape(root / "cameras.xml").photos[0].camera
    assert found is not None and found.lens.fisheye and found.lens.radial == camera.lens.radial


def test_points_and_colours_of_opensfm(root: Path) -> None:
    write_opensfm(root, CAMERA, posed())
    points, colors = read_opensfm(root / "opensfm" / "reconstruction.json").points
    assert points.tolist() == [[1, 2, 3]] and colors.tolist() == [[255, 20, 0]]


def test_where_there_are_no_points_a_ply_beside_is_read_and_else_random_ones(root: Path) -> None:
    write_metashape(root, CAMERA, posed())
    assert "has no points: 10000 random ones" in " ".join(load_scene(root).notes)
    head = "ply\nformat ascii 1.0\nelement vertex 2\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (root / "points3D.ply").write_text(head + "1 2 3\n4 5 6\n")
    records, _ = find_program(root)
    assert records is not None and records.points.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_photos_that_are_missing_and_panoramas_are_left_out_by_name(root: Path) -> None:
    photos = posed(names=(*NAMES, "gone.jpg"))
    write_opensfm(root, CAMERA, photos)
    path = root / "opensfm" / "reconstruction.json"
    every = json.loads(path.read_text())
    every[1]["cameras"]["ball"] = {"projection_type": "spherical", "width": 100, "height": 50}
    every[1]["shots"]["lost.jpg"] = {**every[1]["shots"]["a.jpg"], "camera": "ball"}
    path.write_text(json.dumps(every))
    left = load_scene(root).account.left_out
    assert left == {
        "not on disk": ("gone.jpg",),
        "with a camera that is not read (spherical)": ("lost.jpg",),
    }


def test_the_file_with_most_photos_is_read_and_the_other_named(root: Path) -> None:
    write_opensfm(root, CAMERA, posed()[:2])
    write_realitycapture(root, CAMERA, posed())
    account = load_scene(root).account
    assert account.source == "registration.csv"
    assert (
        "opensfm/reconstruction.json with 2 photos is not read: to use it, take" in account.text()
    )


def test_a_model_of_colmap_comes_first(root: Path) -> None:
    write_metashape(root, CAMERA, posed())
    camera = Pinhole(*SIZE, 40.0, 40.0, 24.0, 16.0, STRAIGHT)
    write_binary(root / "sparse" / "0", replace(tiny_model(NAMES), cameras={1: camera}))
    account = load_scene(root).account
    assert account.source == "sparse/0"
    assert "poses of Metashape are not read (cameras.xml): to use them, take" in account.text()


def test_photos_of_one_name_in_two_folders_are_told_apart(root: Path) -> None:
    for folder in ("left", "right"):
        (root / "images" / folder).mkdir()
        for name in NAMES:
            (root / "images" / folder / name).write_bytes((root / "images" / name).read_bytes())
    for name in NAMES:
        (root / "images" / name).unlink()
    write_realitycapture(root, CAMERA, posed(names=tuple(f"right\\{name}" for name in NAMES)))
    assert [view.name for view in load_scene(root).views] == [f"right/{name}" for name in NAMES]


BAD: dict[str, tuple[str, str, str]] = {
    "broken XML": ("cameras.xml", "<document><chunk>", "Metashape's XML"),
    "nothing aligned": (
        "cameras.xml",
        "<document><chunk><cameras><camera/></cameras></chunk></document>",
        "no camera with a pose",
    ),
    "a number of words": (
        "cameras.xml",
        '<document><chunk><sensors><sensor id="0"><calibration><resolution width="48" height="32"/>'
        '<f>forty</f></calibration></sensor></sensors><cameras><camera sensor_id="0">'
        "<transform>1</transform></camera></cameras></chunk></document>",
        "sensor 0: f: found 'forty'",
    ),
    "no shots": ("reconstruction.json", '[{"cameras": {}, "shots": {}}]', "no shot"),
    "a text for a number": (
        "reconstruction.json",
        '[{"cameras": {"c": {"width": "wide"}}, "shots": {}}]',
        "Expected `int`",
    ),
    "bytes that are no text": ("reconstruction.json", '[{"cameras": {"\udcff": 1}}]', "utf-8"),
    "a cell of a megabyte": (
        "x.csv",
        f"#name,x,y,alt,heading,pitch,roll,f\n{'a' * (1 << 20)}.jpg,1,2,3,4,5,6,7\n",
        "field larger than field limit",
    ),
    "no angles": ("x.csv", "#name,x,y,alt\na.jpg,1,2,3\n", "no column heading, pitch, roll, f"),
    "not a number": (
        "x.csv",
        "#name,x,y,alt,heading,pitch,roll,f\na.jpg,1,2,nan,4,5,6,7\n",
        "camera a.jpg: alt: found nan",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_damaged_file_is_a_phrase_and_the_photos_are_estimated(root: Path, name: str) -> None:
    file, text, words = BAD[name]
    (root / file).write_text(text, "utf-8", "surrogateescape")
    records, phrases = find_program(root)
    assert records is None and len(phrases) == 1
    assert f"are not read ({file}): " in phrases[0] and words in phrases[0]
    with pytest.raises(NoPosesError, match="photos without camera poses") as caught:
        load_scene(root)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_sizes_come_from_the_photos_of_realitycapture(root: Path) -> None:
    write_realitycapture(root, CAMERA, posed())
    found = read_realitycapture(root / "registration.csv", PhotosByLabel(root)).photos[0].camera
    assert found is not None and (found.width, found.height) == SIZE
    assert found.fx == pytest.approx(CAMERA.fx) and found.cy == pytest.approx(CAMERA.cy)
