"""Memory of trainings on many large photos, whose decoded pixels are kept in files.

    python -m benchmarks.train.many_photos

Makes a scene of 300 photos of 12 megapixels (a procedural room, enlarged and with noise, as JPEG)
and trains some steps at the width of the literature, 1,600 pixels, each case in a process of its
own. Rows go to docs/results/many_photos.csv, a line into scale.md.
"""

import shutil
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from benchmarks.bench import (
    CPU,
    RESULTS,
    Row,
    machine,
    memory_of,
    put,
    short_commit,
    stored_rows,
    write_rows,
)
from gsynopsis.jobs.resolve import resolve
from gsynopsis.jobs.train import train
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.model import Pinhole, Pose, SparseModel, quaternion_from_rotation
from gsynopsis.scene.colmap.read import find_sparse, read_colmap
from gsynopsis.scene.load import load_scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.observer import Silent, StepInfo

CSV = RESULTS / "many_photos.csv"
PAGE = RESULTS / "scale.md"
PHOTOS, WIDTH, HEIGHT = 300, 4000, 3000
SMALL = 20
"""The room is drawn at this fraction of the photos' size."""
POINTS = 20_000
MIB = 2**20


@dataclass(frozen=True)
class Case:
    """One training: training photos, width it trains at, steps, and a limit of memory or none.

    It is stopped after its steps: making the levels afterwards goes over all photos many times,
    which takes hours with so large a number of them.
    """

    photos: int
    width: int
    steps: int = 50
    limit_gib: float = 0.0


CASES = (
    Case(10, 1600),
    Case(262, 1600),
    Case(262, 1600, limit_gib=1.5),
)


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        folder: Folder of the scene, made once; empty: a temporary folder.
        only: Numbers of the rows to measure, from 0; nothing is written then.
        page: Measure nothing, write the page from the CSV.
    """

    folder: Path | None = None
    only: tuple[int, ...] = ()
    page: bool = False


def make_photos(folder: Path) -> Path:
    """The scene in a folder, unless it is there."""
    scene = folder / "scene"
    if (scene / "made").exists():
        return scene
    small = make_scene(
        "room",
        folder / "small",
        views=PHOTOS,
        width=WIDTH // SMALL,
        height=HEIGHT // SMALL,
        points=POINTS,
    )
    shutil.rmtree(scene, ignore_errors=True)
    (scene / "images").mkdir(parents=True)
    noise = np.random.default_rng(0).normal(0, 6, (HEIGHT, WIDTH, 3)).astype(np.float32)
    sparse = find_sparse(small)
    assert sparse is not None
    listing = read_colmap(small, sparse, small / "images")
    poses = list[Pose]()
    for number, view in enumerate(sorted(listing.views, key=lambda view: view.name)):
        # Each photo has noise of its own, so that none is alike another.
        name = f"{number:04d}.jpg"
        with Image.open(view.path) as stored:
            large = stored.convert("RGB").resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC)
        pixels = np.asarray(large, np.float32) + np.roll(noise, 37 * number, axis=1)
        image = Image.fromarray(pixels.clip(0, 255).astype(np.uint8))
        image.save(scene / "images" / name, quality=90)
        pose = view.camera.w2c
        x, y, z = pose[:3, 3].tolist()
        poses.append(Pose(name, 1, quaternion_from_rotation(pose[:3, :3]), (x, y, z)))
    own = listing.views[0].camera
    lens = Pinhole(WIDTH, HEIGHT, own.fx * SMALL, own.fy * SMALL, own.cx * SMALL, own.cy * SMALL)
    model = SparseModel({1: lens}, tuple(poses), listing.points, listing.colors)
    write_binary(scene / "sparse" / "0", model)
    (scene / "made").touch()
    return scene


class Memory:
    """Peaks of this process, sampled by a thread: resident bytes by kind of mapping."""

    def __init__(self) -> None:
        self.peaks = {"RssAnon": 0, "RssFile": 0, "VmRSS": 0}
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.wait(0.02):
            now = memory_of()
            self.peaks = {name: max(peak, now[name]) for name, peak in self.peaks.items()}

    def stop(self) -> dict[str, int]:
        """The peaks, bytes."""
        self._done.set()
        self._thread.join()
        return self.peaks


class StopAfter(Silent):
    """Ends a training as Ctrl-C does."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def on_step(self, info: StepInfo) -> None:
        """Interrupt the training after the last step."""
        if info.step == self.steps:
            raise KeyboardInterrupt


def measured(case: Case, scene_folder: Path) -> Row:
    """One training in this process, its time and its memory."""
    memory = Memory()
    scene = load_scene(scene_folder)
    scene = replace(scene, train=scene.train[: case.photos])
    asked = {"scale": WIDTH / case.width, "train.steps": case.steps + 1}
    recipe = resolve("standard", scene, asked)
    options = {"evaluate": False, "max_memory": case.limit_gib or None}
    with tempfile.TemporaryDirectory(dir=scene_folder.parent) as out:
        begun = time.monotonic()
        with suppress(KeyboardInterrupt):
            train(scene, recipe, Path(out), StopAfter(case.steps), **options)
        seconds = time.monotonic() - begun
        kept = sum(1 for _ in Path(out).glob("photos/*"))
    peaks = memory.stop()
    decoded = 3 * len(scene.train) * case.width * (case.width * HEIGHT // WIDTH)
    return {
        **asdict(case),
        "photos": len(scene.train),
        "one_sampling_mib": round(decoded / MIB),
        "anon_mib": round(peaks["RssAnon"] / MIB),
        "file_mib": round(peaks["RssFile"] / MIB),
        "resident_mib": round(peaks["VmRSS"] / MIB),
        "seconds": round(seconds, 1),
        "images_kept": kept,
    }


def text_of(rows: list[Row]) -> str:
    """All rows, for the page."""
    parts: list[str] = []
    for row in rows:
        limit = f"{row['limit_gib']:g} GiB" if row["limit_gib"] else "none"
        parts.append(
            f"{row['photos']} photos, limit {limit}: {row['resident_mib']:,} MiB "
            f"({row['anon_mib']:,} own, {row['file_mib']:,} mapped; decoded once "
            f"{row['one_sampling_mib']:,}) in {row['seconds']:.0f} s"
        )
    first = rows[0]
    made = f"{first['steps']} steps each, {first['machine']}, commit {first['commit']}."
    return f"{'; '.join(parts)}. {made}"


def main() -> None:
    """Make the scene, measure, write."""
    options = tyro.cli(Options)
    if options.page:
        put(PAGE, __file__, text_of(stored_rows(CSV, ("machine", "commit"))))
        return
    with tempfile.TemporaryDirectory() as fallback:
        folder = options.folder or Path(fallback)
        folder.mkdir(parents=True, exist_ok=True)
        scene = make_photos(folder)
        rows: list[Row] = []
        for number, case in enumerate(CASES):
            if options.only and number not in options.only:
                continue
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                row = pool.submit(measured, case, scene).result()
            row |= {"machine": machine(CPU).cpu, "commit": short_commit()}
            print(row, flush=True)
            rows.append(row)
    if not options.only:
        write_rows(CSV, rows)
        put(PAGE, __file__, text_of(rows))
        print(CSV, PAGE, sep="\n")


if __name__ == "__main__":
    main()
