"""Random mixtures of the ways in: names, layouts, formats of photos, and one fault each.

    python -m benchmarks.robust.ways                     # 200 mixtures
    python -m benchmarks.robust.ways --only 17 93        # some of them again, by number

Each is a folder of small photos with known poses as one program or another leaves it, with one
fault of those that people report. It has to load as the right scene (these photos at these places,
whose pixels decode, and a line on all that is left out), or end in one line that names the folder.
"""

import json
import re
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.errors import GsynopsisError
from gsynopsis.scene.camera import look_at
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.model import (
    Pinhole,
    Pose,
    SparseModel,
    quaternion_from_rotation,
)
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene

SIZE = (48, 32)
LENS = Pinhole(*SIZE, 40.0, 40.0, 24.0, 16.0)
VIEWS, POINTS = 7, 30
LINE = 4000
"""Characters of an error, at most."""
Float64 = NDArray[np.float64]
Folder = Callable[["Mixture", Path], None]


@dataclass(frozen=True)
class Options:
    """Options of the trial.

    Attributes:
        count: Mixtures.
        only: Numbers of mixtures; all if empty.
        json: Print JSON.
    """

    count: int = 200
    only: tuple[int, ...] = ()
    json: bool = False


@dataclass
class Mixture:
    """One folder: its photos, their poses, and what is right.

    Attributes:
        rng: Chance of this mixture.
        names: Of photos, relative to the folder of photos.
        poses: World to camera of each.
        listed: Names as the file of poses has them.
        photos: Folder of the photos in the scene's.
        lost: Names that must not be in the scene, and be told.
        told: Pattern that must be found in account or notes.
        refused: One line is right as well.
        must_refuse: Nothing else is.
        near: Tolerance of places.
    """

    rng: np.random.Generator
    names: list[str]
    poses: list[Float64]
    listed: list[str]
    photos: str = "images"
    lost: set[str] = field(default_factory=set[str])
    told: str = ""
    refused: bool = False
    must_refuse: bool = False
    near: float = 1e-4


NAMES: dict[str, Callable[[int], str]] = {
    "numbered": lambda n: f"IMG_{n:04}.jpg",
    "words": lambda n: f"photo {n} (2).jpg",
    "folders": lambda n: f"cam{n % 2}/a_{n}.png",
    "unicode": lambda n: f"Zürich é {n}.jpg",
    "dots": lambda n: f"v1.{n}.final.png",
    "upper": lambda n: f"DSC{n}.JPG",
    "digits": lambda n: f"{n}.png",
    "webp": lambda n: f"frame{n:03}.webp",
    "tiff": lambda n: f"scan_{n}.tif",
    "deep": lambda n: f"grey16_{n}.png",
}


def new_mixture(rng: np.random.Generator, style: str) -> Mixture:
    """Photos of one style of names on a ring."""
    names = [NAMES[style](n) for n in range(VIEWS)]
    poses = list[Float64]()
    for angle in np.arange(VIEWS) * (2 * np.pi / VIEWS):
        place = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1 + 0.1 * np.sin(3 * angle)])
        poses.append(look_at(place, np.zeros(3), np.array([0.0, 0.0, 1.0])))
    return Mixture(rng, names, poses, [*names])


def write_photos(mixture: Mixture, root: Path) -> None:
    """Smooth pictures in the format that the ending says."""
    for name in mixture.names:
        path = root / mixture.photos / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cells = mixture.rng.integers(0, 256, (4, 6, 3)).astype(np.uint8)
        image = Image.fromarray(cells).resize(SIZE, Image.Resampling.BICUBIC)
        if name.startswith("grey16"):
            image = Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257)
        image.save(path)


def points_of(mixture: Mixture) -> tuple[Float64, NDArray[np.uint8]]:
    """Sparse points around the middle."""
    places = mixture.rng.normal(size=(POINTS, 3)) * 0.5
    return places, mixture.rng.integers(0, 256, (POINTS, 3)).astype(np.uint8)


def binary_model(folder: str) -> Folder:
    """COLMAP's binary files in a folder."""

    def write(mixture: Mixture, root: Path) -> None:
        images = list[Pose]()
        for name, w2c in zip(mixture.listed, mixture.poses, strict=True):
            x, y, z = w2c[:3, 3].tolist()
            images.append(Pose(name, 1, quaternion_from_rotation(w2c[:3, :3]), (x, y, z)))
        write_binary(root / folder, SparseModel({1: LENS}, tuple(images), *points_of(mixture)))

    return write


def text_model(folder: str, kind: str = "PINHOLE 48 32 40 40 24 16") -> Folder:
    """COLMAP's text files in a folder."""

    def write(mixture: Mixture, root: Path) -> None:
        (root / folder).mkdir(parents=True, exist_ok=True)
        (root / folder / "cameras.txt").write_text(f"# cameras\n1 {kind}\n")
        lines = ["# images"]
        for number, (name, w2c) in enumerate(zip(mixture.listed, mixture.poses, strict=True)):
            values = [*quaternion_from_rotation(w2c[:3, :3]), *w2c[:3, 3].tolist()]
            lines += [f"{number + 1} {' '.join(map(repr, values))} 1 {name}", "3.5 4.5 1"]
        (root / folder / "images.txt").write_text("\n".join(lines) + "\n", "utf-8")
        places, colors = points_of(mixture)
        pairs = zip(places.tolist(), colors.tolist(), strict=True)
        rows = [
            " ".join(map(str, [n + 1, *place, *color, 0.5, 1, 0]))
            for n, (place, color) in enumerate(pairs)
        ]
        (root / folder / "points3D.txt").write_text("# points\n" + "\n".join(rows) + "\n")

    return write


def transforms(mixture: Mixture, root: Path) -> None:
    """Nerfstudio's file."""
    frames = list[dict[str, Any]]()
    for name, w2c in zip(mixture.listed, mixture.poses, strict=True):
        matrix = np.linalg.inv(w2c) @ np.diag([1.0, -1.0, -1.0, 1.0])
        path = f"{mixture.photos}/{name}"
        frames.append({"file_path": path, "transform_matrix": matrix.tolist()})
    lens = {"w": 48, "h": 32, "fl_x": 40.0, "fl_y": 40.0, "cx": 24.0, "cy": 16.0}
    (root / "transforms.json").write_text(json.dumps({**lens, "frames": frames}), "utf-8")


def opensfm(mixture: Mixture, root: Path) -> None:
    """OpenSfM's reconstruction.json."""
    shots: dict[str, Any] = {}
    for name, w2c in zip(mixture.listed, mixture.poses, strict=True):
        w, *xyz = quaternion_from_rotation(w2c[:3, :3])
        half = float(np.arccos(np.clip(w, -1, 1)))
        turn = np.array(xyz) * (2 * half / np.sin(half) if half > 1e-9 else 2)
        place = {"rotation": turn.tolist(), "translation": w2c[:3, 3].tolist()}
        shots[name] = {**place, "camera": "c"}
    lens = {"projection_type": "brown", "width": 48, "height": 32, "focal_x": 40 / 48}
    places, colors = points_of(mixture)
    points = {
        str(n): {"coordinates": place, "color": color}
        for n, (place, color) in enumerate(zip(places.tolist(), colors.tolist(), strict=True))
    }
    camera = {"c": {**lens, "focal_y": 40 / 48}}
    document = [{"cameras": camera, "shots": shots, "points": points}]
    (root / "reconstruction.json").write_text(json.dumps(document), "utf-8")


def metashape(mixture: Mixture, root: Path) -> None:
    """Agisoft's XML."""
    size = '<resolution width="48" height="32"/>'
    sensor = (
        f'<sensor id="0" type="frame">{size}<calibration>{size}<f>40</f></calibration></sensor>'
    )
    cameras = ""
    for name, w2c in zip(mixture.listed, mixture.poses, strict=True):
        c2w = " ".join(repr(float(v)) for v in np.linalg.inv(w2c).flatten())
        label = f'<camera sensor_id="0" label="{name}"><transform>{c2w}</transform></camera>'
        cameras += label
    text = f"<chunk><sensors>{sensor}</sensors><cameras>{cameras}</cameras></chunk>"
    (root / "cameras.xml").write_text(f"<document>{text}</document>", "utf-8")


LAYOUTS: dict[str, tuple[Folder, str]] = {
    "sparse/0 binary": (binary_model("sparse/0"), "images"),
    "sparse/0 text": (text_model("sparse/0"), "images"),
    "sparse text": (text_model("sparse"), "images"),
    "colmap/sparse/0": (binary_model("colmap/sparse/0"), "images"),
    "dense/0/sparse": (binary_model("dense/0/sparse"), "images"),
    "distorted, input": (binary_model("distorted/sparse/0"), "input"),
    "the folder itself": (text_model("."), "images"),
    "a lens": (text_model("sparse/0", "SIMPLE_RADIAL 48 32 40 24 16 0.02"), "images"),
    "transforms.json": (transforms, "images"),
    "OpenSfM": (opensfm, "images"),
    "Metashape": (metashape, "images"),
}
TEXTS = ("sparse/0 text", "sparse text", "the folder itself", "a lens")
POSES = {
    "OpenSfM": "reconstruction.json",
    "Metashape": "cameras.xml",
    "transforms.json": "transforms.json",
}


def listing_of(layout: str, root: Path, name: str = "images") -> Path:
    """The file of poses of a layout."""
    if layout in POSES:
        return root / POSES[layout]
    return next(path for path in root.rglob(f"{name}.*") if path.suffix in (".bin", ".txt"))


def nothing(mixture: Mixture, root: Path, layout: str) -> None:
    """No fault."""


def photos_gone(mixture: Mixture, root: Path, layout: str) -> None:
    """Two photos were thrown away."""
    for name in mixture.names[1:3]:
        (root / mixture.photos / name).unlink()
        mixture.lost.add(name)
    mixture.told = "not on disk"


def photos_added(mixture: Mixture, root: Path, layout: str) -> None:
    """Photos that have no pose."""
    for number in range(2):
        Image.new("RGB", SIZE, (9, 90, 9)).save(root / mixture.photos / f"extra{number}.png")
    mixture.told = r"2 without a pose \((images/)?extra0\.png, (images/)?extra1\.png\)"


def heic_beside(mixture: Mixture, root: Path, layout: str) -> None:
    """Photos of a phone that are not read."""
    (root / mixture.photos / "IMG_9.HEIC").write_bytes(b"ftypheic")
    mixture.told = r"1 \.heic"


def other_case(mixture: Mixture, root: Path, layout: str) -> None:
    """A copy by way of Windows changed the case of the endings."""
    for number, name in enumerate(mixture.names):
        path = root / mixture.photos / name
        new = Path(name).with_suffix(Path(name).suffix.swapcase()).as_posix()
        path.rename(root / mixture.photos / new)
        mixture.names[number] = new


def mark_of_order(mixture: Mixture, root: Path, layout: str) -> None:
    """Windows' editor puts a mark before a text."""
    for path in root.rglob("*"):
        if path.suffix in (".txt", ".json", ".xml"):
            path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    mixture.refused = True


def windows_lines(mixture: Mixture, root: Path, layout: str) -> None:
    """Its ends of lines."""
    for path in root.rglob("*.txt"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))


def cut_off(mixture: Mixture, root: Path, layout: str) -> None:
    """A copy that ended early."""
    path = listing_of(layout, root)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    mixture.refused = True


def emptied(mixture: Mixture, root: Path, layout: str) -> None:
    """A copy that never began."""
    listing_of(layout, root).write_bytes(b"")
    mixture.must_refuse = True


def no_number(mixture: Mixture, root: Path, layout: str) -> None:
    """A word where a number should be."""
    path = listing_of(layout, root)
    data = path.read_bytes()
    at = [m.start() for m in re.finditer(rb"0\.\d{6,}", data)]
    if at and path.suffix != ".bin":
        place = at[len(at) // 2]
        path.write_bytes(data[:place] + b"nonsense" + data[place + 8 :])
    mixture.refused = True


def lost_pose(mixture: Mixture, root: Path, layout: str) -> None:
    """Tracking lost one camera."""
    name = mixture.names[2]
    mixture.poses[2][:3, 3] = np.nan
    mixture.lost.add(name)
    LAYOUTS[layout][0](mixture, root)
    mixture.told, mixture.refused = "not finite|without a pose", True


def rounded(mixture: Mixture, root: Path, layout: str) -> None:
    """Numbers of three digits."""
    for path in [p for p in root.rglob("*") if p.suffix in (".txt", ".json", ".xml")]:
        text = path.read_text("utf-8")
        path.write_text(re.sub(r"(\d\.\d{3})\d+", r"\1", text), "utf-8")
    mixture.near, mixture.refused = 0.05, layout in ("transforms.json", "Metashape")


def masks(mixture: Mixture, root: Path, layout: str) -> None:
    """Masks go along."""
    for name in mixture.names:
        path = root / "masks" / Path(name).with_suffix(".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", SIZE, 255).save(path)
    mixture.told = rf"masks: {VIEWS} of {VIEWS} photos"


def odd_masks(mixture: Mixture, root: Path, layout: str) -> None:
    """Masks of another shape."""
    masks(mixture, root, layout)
    for path in (root / "masks").rglob("*.png"):
        Image.new("L", (30, 30), 255).save(path)
    mixture.must_refuse = True


def small_model_first(mixture: Mixture, root: Path, layout: str) -> None:
    """Another model has three of the photos."""
    few = Mixture(mixture.rng, mixture.names[:3], mixture.poses[:3], mixture.listed[:3])
    if layout in POSES:
        return
    where = "sparse/7" if layout.startswith(("sparse/0", "a lens")) else "sparse/0"
    if layout == "sparse text":
        where = "colmap/sparse/0"
    binary_model(where)(few, root)
    mixture.told = "not read"


def other_size(mixture: Mixture, root: Path, layout: str) -> None:
    """One photo of another shape."""
    Image.new("RGB", (50, 20)).save(root / mixture.photos / mixture.names[0])
    mixture.must_refuse = True


def no_photo(mixture: Mixture, root: Path, layout: str) -> None:
    """One photo is a text."""
    (root / mixture.photos / mixture.names[0]).write_text("<html>not found</html>")
    mixture.must_refuse = True


def out_of_the_folder(mixture: Mixture, root: Path, layout: str) -> None:
    """A name that leads elsewhere."""
    mixture.listed[1] = "/".join(("..", "..", "secret.png"))
    LAYOUTS[layout][0](mixture, root)
    mixture.lost.add(mixture.names[1])
    mixture.told, mixture.refused = "not on disk|without a pose", True


def on_a_map(mixture: Mixture, root: Path, layout: str) -> None:
    """UTM."""
    for w2c in mixture.poses:
        w2c[:3, 3] -= w2c[:3, :3] @ [500_000.0, 5_400_000.0, 100.0]
    LAYOUTS[layout][0](mixture, root)
    mixture.told, mixture.near = "moved by minus", 1e-2


def backslashes(mixture: Mixture, root: Path, layout: str) -> None:
    """Names as Windows writes them."""
    mixture.listed = [name.replace("/", "\\") for name in mixture.listed]
    LAYOUTS[layout][0](mixture, root)


def points_gone(mixture: Mixture, root: Path, layout: str) -> None:
    """No points."""
    for path in root.rglob("points3D.*"):
        path.unlink()
    if layout not in (*POSES,):
        mixture.told = "random ones|no points"


FAULTS = (
    *(nothing, photos_gone, photos_added, heic_beside, other_case, mark_of_order, windows_lines),
    *(cut_off, emptied, no_number, lost_pose, rounded, masks, odd_masks, small_model_first),
    *(other_size, no_photo, out_of_the_folder, on_a_map, backslashes, points_gone),
)


def make(number: int, root: Path) -> tuple[str, Mixture]:
    """The folder of a mixture; its description, and what is right."""
    rng = np.random.default_rng([7, number])
    # Layouts and faults by turns, so that 200 hold all of each; the rest by chance.
    layout = [*LAYOUTS][number % len(LAYOUTS)]
    fault = FAULTS[number % len(FAULTS)]
    style = [*NAMES][int(rng.integers(len(NAMES)))]
    mixture = new_mixture(rng, style)
    write, mixture.photos = LAYOUTS[layout]
    write_photos(mixture, root)
    write(mixture, root)
    fault(mixture, root, layout)
    return f"{layout}, {style}, {fault.__name__}", mixture


def verdict(mixture: Mixture, root: Path) -> str:
    """The fault of how a folder loads; empty if there is none."""
    try:
        scene = load_scene(root)
        for view in range(len(scene.views)):
            scene.image(view)
    except GsynopsisError as error:
        line = str(error)
        if "\n" in line or len(line) > LINE or str(root) not in line:
            return f"no line: {line[:300]}"
        return "" if mixture.refused or mixture.must_refuse else f"refused: {line[:400]}"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:300]}"
    return "loads, and should not" if mixture.must_refuse else wrong_in(scene, mixture)


def wrong_in(scene: Scene, mixture: Mixture) -> str:
    """The fault of a scene that has loaded; empty if there is none."""
    said = " ".join([scene.account.text(), *scene.notes])
    found = {view.path.name: view.camera.position + scene.shift for view in scene.views}
    wanted = {
        Path(name).name: -w2c[:3, :3].T @ w2c[:3, 3]
        for name, w2c in zip(mixture.names, mixture.poses, strict=True)
        if name not in mixture.lost
    }
    if found.keys() != wanted.keys():
        lacking = sorted({*wanted} - {*found})
        # One line for all that is left out is enough where a fault may be refused as well.
        if not (mixture.refused and lacking and all(name in said for name in lacking)):
            return f"{sorted(found)} in place of {sorted(wanted)}: {said[:300]}"
    far = [n for n in found if n in wanted and np.abs(found[n] - wanted[n]).max() > mixture.near]
    if far:
        return f"{far[0]} stands at {found[far[0]]}, not {wanted[far[0]]}"
    if mixture.told and not re.search(mixture.told, said):
        return f"does not say {mixture.told}: {said[:400]}"
    return ""


def main() -> int:
    options, troubles = tyro.cli(Options, description=__doc__), dict[str, str]()
    warnings.simplefilter("ignore")  # as the command does
    numbers = options.only or range(options.count)
    for number in numbers:
        with tempfile.TemporaryDirectory() as name:
            root = Path(name).resolve() / "scene"
            root.mkdir()
            what, mixture = make(number, root)
            if trouble := verdict(mixture, root):
                troubles[f"{number}: {what}"] = trouble
    if options.json:
        print(json.dumps({"tried": len(numbers), "trouble": troubles}))
    else:
        for what, trouble in troubles.items():
            print(f"{what}\n    {trouble}")
        print(f"{len(numbers)} mixtures, {len(troubles)} wrong")
    return int(bool(troubles))


if __name__ == "__main__":
    sys.exit(main())
