"""A small valid example for each reader of other people's files, and what reads it."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import gaussforge  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from PIL import Image

from gsynopsis.capture.photo_set import gather
from gsynopsis.capture.video import check_video, is_video, take_frames
from gsynopsis.errors import SceneError
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.forge import forge_bytes
from gsynopsis.formats.writers.glb import glb_bytes
from gsynopsis.formats.writers.packed import packed_bytes
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.formats.writers.sog import sog_bytes, sog_files
from gsynopsis.formats.writers.ssog import ssog_files
from gsynopsis.formats.writers.usd import usd_bytes
from gsynopsis.jobs.estimate_poses import digest_of
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.resolve import resolve
from gsynopsis.jobs.train_run import make_context
from gsynopsis.records import PlainGaussians
from gsynopsis.runs.folder import read_run, recorded_config, write_record
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.photo_files import PhotoStore
from gsynopsis.scene.photos import load_photo
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import CHECKPOINT, open_state, run_training
from gsynopsis.training.observer import Silent
from research.suites.suite import read_suite

SUITE = """seeds = [0, 1]
[scenes.a]
path = "procedural:tiny"
scale = 2.0
[methods.ours]
preset = "standard"
set = { train.steps = 30, levels.steps = 20 }
[methods.plain]
preset = "standard"
set = { model.feature = "free" }
"""
SPLATS, VIEWS = 60, 4
FILMS = {"mp4": "mpeg4", "mkv": "mpeg4", "avi": "mpeg4", "mov": "mpeg4"}
"""Containers of videos, and an encoder that all builds of ffmpeg have."""


@dataclass(frozen=True)
class Door:
    """A reader of other people's files.

    Attributes:
        name: For people.
        make: Fills a folder with an example; the names of its files that are spoilt.
        use: Reads the folder.
        links: A link under the name of a file is followed, as people link photos.
    """

    name: str
    make: Callable[[Path], tuple[str, ...]]
    use: Callable[[Path], object]
    links: bool = True


def gaussians(count: int = SPLATS) -> PlainGaussians:
    """Gaussians with harmonics of degree 1, in a box of ±2."""
    rng = np.random.default_rng(0)
    values = [rng.normal(size=s).astype(np.float32) for s in ((count, 3), (count, 3), (count, 4))]
    means, scales, quaternions = values
    harmonics = rng.normal(size=(count, 4, 3)).astype(np.float32) * 0.2
    logits = rng.normal(size=count).astype(np.float32)
    return PlainGaussians(means, scales * 0.3 - 3, quaternions, logits, harmonics)


@cache
def setup_of(scene: Path) -> TrainContext:
    """Setup of the shortest training of a scene that has all phases."""
    loaded = load_scene(scene)
    recipe = resolve(
        "standard", loaded, {"train.steps": 6, "levels.steps": 6, "model.table_log2": 4}
    )
    return make_context(loaded, recipe.config, RunOptions(device="cpu"))


def small_scene(folder: Path) -> Path:
    """Photos and a binary COLMAP model."""
    return make_scene("room", folder, views=VIEWS, width=16, height=12, points=40)


def written(name: str, make: Callable[[], bytes]) -> Callable[[Path], tuple[str, ...]]:
    """One file of bytes."""

    def fill(folder: Path) -> tuple[str, ...]:
        (folder / name).write_bytes(make())
        return (name,)

    return fill


def unpacked(files: Callable[[], dict[str, bytes]]) -> Callable[[Path], tuple[str, ...]]:
    """Several files, each of which is spoilt in turn; JSON more often."""

    def fill(folder: Path) -> tuple[str, ...]:
        made = files()
        for name, data in made.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        documents = [name for name in made if name.endswith(".json")]
        return (*made, *documents * len(made))

    return fill


def lods() -> dict[str, bytes]:
    """Streamed SOG of two levels."""
    return ssog_files([gaussians(20), gaussians()])


def ksplat() -> bytes:
    """A `.ksplat` of mkkellogg's viewer."""
    made = gaussforge.GaussForge().convert(ply_bytes(gaussians()), "ply", "ksplat")
    return bytes(made["data"])


def run_record(folder: Path) -> tuple[str, ...]:
    """A run's record."""
    scene = load_scene(small_scene(folder / "scene"))
    recipe = resolve("standard", scene)
    write_record(folder, scene, recipe.config, recipe)
    return ("run.json",)


def use_record(folder: Path) -> object:
    """As `evaluate`, `unfold` and `pack` begin."""
    return read_run(folder), recorded_config(folder)


def checkpoint_at(steps: int) -> Callable[[Path], tuple[str, ...]]:
    """A training that was stopped after `steps` steps."""

    def fill(folder: Path) -> tuple[str, ...]:
        context = setup_of(small_scene(folder / "scene"))
        left = [steps]

        def stop() -> bool:
            left[0] -= 1
            return left[0] <= 0

        run_training(open_state(context, folder, Silent()), folder, Silent(), stop)
        return (CHECKPOINT,)

    return fill


def use_checkpoint(folder: Path) -> object:
    """Go on for two steps with the scene that `checkpoint_at` made beside."""
    count = [2]

    def stop() -> bool:
        count[0] -= 1
        return count[0] <= 0

    made = sorted(folder.parent.glob("checkpoint*"))
    context = setup_of(made[-1] / "scene")
    return run_training(open_state(context, folder, Silent()), folder, Silent(), stop)


def photo_store(folder: Path) -> tuple[str, ...]:
    """A photo, and its decoded pixels."""
    pixels = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    Image.fromarray(pixels).save(folder / "a.png")
    PhotoStore(folder / "kept").get(folder / "a.png", 2)
    return tuple(f"kept/{path.name}" for path in (folder / "kept").iterdir())


def use_photo_store(folder: Path) -> object:
    """Other pixels than the photo's are none."""
    store = PhotoStore(folder / "kept")
    found = store.get(folder / "a.png", 2)
    assert np.array_equal(found, load_photo(folder / "a.png", 2)), "other pixels"
    return found


def colmap_binary(folder: Path) -> tuple[str, ...]:
    """A scene with a binary model."""
    small_scene(folder)
    return tuple(f"sparse/0/{name}.bin" for name in ("cameras", "images", "points3D"))


def colmap_text(folder: Path) -> tuple[str, ...]:
    """The same form as text."""
    images(folder / "images")
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("# c\n1 OPENCV 16 12 20 20 8 6 0.1 0 0 0\n")
    poses = [f"{n + 1} 1 0 0 0 {n / 9} 0 4 1 {n}.png\n1 2 -1\n" for n in range(VIEWS)]
    (model / "images.txt").write_text("# i\n" + "".join(poses))
    points = [f"{n} {n % 3} {n % 5} {n % 2} 10 20 30 0.5 1 0\n" for n in range(40)]
    (model / "points3D.txt").write_text("# p\n" + "".join(points))
    return tuple(f"sparse/0/{name}.txt" for name in ("cameras", "images", "points3D"))


def transforms(folder: Path) -> tuple[str, ...]:
    """A scene of nerfstudio with points."""
    images(folder / "images")
    frames = []
    for number in range(VIEWS):
        matrix = np.eye(4)
        matrix[:3, 3] = number / 9, 0, 4
        path = f"images/{number}.png"
        frames.append({"file_path": path, "transform_matrix": matrix.tolist()})
    lens = {"camera_model": "OPENCV", "w": 16, "h": 12, "fl_x": 20.0, "cx": 8, "cy": 6, "k1": 0.1}
    document = {**lens, "ply_file_path": "points.ply", "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    fields = "property float x\nproperty float y\nproperty float z\n"
    head = f"ply\nformat ascii 1.0\nelement vertex 40\n{fields}end_header\n"
    rows = [f"{n % 3} {n % 5} {n % 2}\n" for n in range(40)]
    (folder / "points.ply").write_text(head + "".join(rows))
    return ("transforms.json",) * 3 + ("points.ply",)


def metashape(folder: Path) -> tuple[str, ...]:
    """Photos with cameras of Metashape."""
    images(folder / "images")
    size = '<resolution width="16" height="12"/>'
    lens = f"<calibration>{size}<f>20</f><cx>0.5</cx><k1>0.1</k1><p1>0.01</p1></calibration>"
    cameras = "".join(
        f'<camera sensor_id="0" label="{n}"><transform>1 0 0 {n / 9} 0 1 0 0 0 0 1 4 0 0 0 1'
        "</transform></camera>"
        for n in range(VIEWS)
    )
    sensor = f'<sensors><sensor id="0" type="frame">{size}{lens}</sensor></sensors>'
    chunk = f'<chunk label="a">{sensor}<cameras>{cameras}</cameras></chunk>'
    (folder / "cameras.xml").write_text(f"<document>{chunk}</document>")
    return ("cameras.xml",)


def opensfm(folder: Path) -> tuple[str, ...]:
    """Photos with a reconstruction of OpenSfM."""
    images(folder / "images")
    lens = {"projection_type": "brown", "width": 16, "height": 12, "focal_x": 1.2, "focal_y": 1.2}
    shots = {
        f"{n}.png": {"rotation": [0, 0.1, 0], "translation": [n / 9, 0, 4], "camera": "c"}
        for n in range(VIEWS)
    }
    points = {str(n): {"coordinates": [n % 3, n % 5, n % 2], "color": [1, 2, 3]} for n in range(40)}
    document = [{"cameras": {"c": {**lens, "k1": 0.1}}, "shots": shots, "points": points}]
    (folder / "reconstruction.json").write_text(json.dumps(document))
    return ("reconstruction.json",)


def realitycapture(folder: Path) -> tuple[str, ...]:
    """Photos with RealityCapture's table of cameras."""
    images(folder / "images")
    rows = [f"{n}.png,{n / 9},0,4,10,80,3,40,0.01,0,0.1,0,0,0,0,0\n" for n in range(VIEWS)]
    head = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n"
    (folder / "registration.csv").write_text(head + "".join(rows))
    return ("registration.csv",)


def images(folder: Path) -> tuple[str, ...]:
    """Photos of all formats that scenes have."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    for number in range(VIEWS):
        pixels = rng.integers(0, 256, (12, 16, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"{number}.png")
    return tuple(f"{number}.png" for number in range(VIEWS))


def photos(folder: Path) -> tuple[str, ...]:
    """Photos of several formats."""
    images(folder)
    for number, suffix in enumerate(("jpg", "webp", "tif", "bmp")):
        Image.open(folder / f"{number}.png").save(folder / f"{number}.{suffix}")
    return tuple(path.name for path in folder.iterdir())


def use_photos(folder: Path) -> object:
    """As `scene` gathers them, and as a training decodes each, the spoilt one too."""
    return gather(folder), [load_photo(path, 2) for path in sorted(folder.iterdir())]


def use_scene(folder: Path) -> object:
    """As a training reads it."""
    scene: Scene = load_scene(folder)
    return [scene.image(view, 1) for view in range(len(scene.views))]


def film(suffix: str) -> Callable[[Path], tuple[str, ...]]:
    """A video of a second."""

    def fill(folder: Path) -> tuple[str, ...]:
        import subprocess

        frames = np.random.default_rng(0).integers(0, 256, (12, 32, 48, 3), np.uint8)
        line = ["ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        line += ["-s", "48x32", "-r", "12", "-i", "-", "-c:v", FILMS[suffix], "-q:v", "2"]
        path = folder / f"film.{suffix}"
        subprocess.run([*line, str(path)], input=frames.tobytes(), check=True, timeout=60)
        return (path.name,)

    return fill


def use_film(folder: Path) -> object:
    """As `scene` takes photos of a video."""
    (path,) = [p for p in folder.iterdir() if p.name.startswith("film.")] or [folder / "film.mp4"]
    if not is_video(path):
        raise SceneError(path, found="no file", expected="a video")
    check_video(path)
    return take_frames(path, digest_of(path), folder / "frames", 5, lambda done, total: None)


def _splats(name: str) -> Callable[[Path], object]:
    return lambda folder: read_splats(folder / name)


DOORS: tuple[Door, ...] = (
    Door("record", run_record, use_record, links=False),
    Door("checkpoint-full", checkpoint_at(3), use_checkpoint, links=False),
    Door("checkpoint-levels", checkpoint_at(9), use_checkpoint, links=False),
    Door("photo-store", photo_store, use_photo_store, links=False),
    Door("suite", written("s.toml", SUITE.encode), lambda folder: read_suite(folder / "s.toml")),
    Door("ply", written("a.ply", lambda: ply_bytes(gaussians())), _splats("a.ply")),
    Door("packed-ply", written("a.ply", lambda: packed_bytes(gaussians())), _splats("a.ply")),
    Door("spz", written("a.spz", lambda: forge_bytes(gaussians(), "spz3")), _splats("a.spz")),
    Door("spz-4", written("a.spz", lambda: forge_bytes(gaussians(), "spz")), _splats("a.spz")),
    Door("sog", unpacked(lambda: sog_files(gaussians())), _splats("meta.json")),
    Door("sog-zip", written("a.sog", lambda: sog_bytes(gaussians())), _splats("a.sog")),
    Door("lod-meta", unpacked(lods), _splats("lod-meta.json")),
    Door("ksplat", written("a.ksplat", ksplat), _splats("a.ksplat")),
    Door("glb", written("a.glb", lambda: glb_bytes(gaussians())), _splats("a.glb")),
    Door("usd", written("a.usdc", lambda: usd_bytes(gaussians())), _splats("a.usdc")),
    Door("transforms", transforms, use_scene),
    Door("metashape", metashape, use_scene),
    Door("opensfm", opensfm, use_scene),
    Door("realitycapture", realitycapture, use_scene),
    Door("colmap-text", colmap_text, use_scene),
    Door("colmap-binary", colmap_binary, use_scene),
    Door("photos", photos, use_photos),
    *(Door(f"video-{suffix}", film(suffix), use_film) for suffix in FILMS),
)
