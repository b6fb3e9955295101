"""`gsynopsis render`: images and flights from a file."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from PIL import Image
from tyro.conf import Positional

from gsynopsis.cameras.orbit import (
    DEFAULT_SIZE,
    Circle,
    circle_of_cameras,
    circle_of_levels,
    default_lens,
    orbit,
    sized,
)
from gsynopsis.cli.bounds import Backend, bounded, positive, with_training
from gsynopsis.cli.defaults import said
from gsynopsis.cli.flight import check_flight, write_flight
from gsynopsis.errors import SettingError
from gsynopsis.files import published
from gsynopsis.monitor.display import ticking
from gsynopsis.runs.folder import find_run, scene_of
from gsynopsis.scene.camera import Camera

if TYPE_CHECKING:
    from gsynopsis.evaluation.load_model import Opened
    from gsynopsis.evaluation.metrics import Image8
    from gsynopsis.records import LevelSet
    from gsynopsis.scene.scene import Scene

ORBIT = 60
"""Images of an orbit when no number is given."""
PICTURES = (1, 100_000)
"""Fewest and most of an orbit."""
SIDE = (1, 8192)
"""Pixels."""
FPS = (0.02, 1000)
"""Images per second: a gif shows one for at most 655 s."""
Tick = Callable[[int, int], None]
Shot = tuple[str, Camera]
"""A name for the image, and its camera."""


@dataclass(frozen=True)
class Render:
    """Write images of a file: the scene's own views, or a flight around it.

    Attributes:
        target: A .gsyn file, or the folder of a run.
        out: Folder for the images, as PNG.
        flight: Also join the images to this .gif or .mp4 (mp4 needs the program ffmpeg).
        level: Level of detail, 0 is the coarsest; the finest if not given.
        views: Views of the scene to draw; test if a scene is known and no orbit is asked for.
        orbit: Draw this many images around the scene instead, where its photos were taken from.
        all_round: Orbit all the way round, also where no photo was taken.
        scene: Folder of the scene; a run knows its own.
        scale: Divide the photos' width and height by this; a run knows its own.
        width: Width of the images, pixels.
        height: Height of the images, pixels.
        fps: Images per second of the flight.
        renderer: Rasteriser; auto takes CUDA where it is there.
        quiet: No progress.
    """

    target: Positional[Path]
    out: Annotated[Path | None, said("none")] = None
    flight: Annotated[Path | None, said("none")] = None
    level: Annotated[int | None, said("the finest")] = None
    views: Annotated[Literal["test", "train", "all"] | None, said("test, or an orbit")] = None
    orbit: Annotated[int | None, said(f"{ORBIT} where no scene is known")] = None
    all_round: bool = False
    scene: Annotated[Path | None, said("the run's")] = None
    scale: Annotated[float | None, said("the run's")] = None
    width: Annotated[int | None, said(f"the photos', or {DEFAULT_SIZE[0]}")] = None
    height: Annotated[int | None, said(f"the photos', or {DEFAULT_SIZE[1]}")] = None
    fps: float = 24.0
    renderer: Backend = "auto"
    quiet: bool = False

    def run(self) -> int:
        """Draw and write."""
        self._check()
        run = find_run(self.target)
        scene = None
        if self.views or self.scene or run.scene:
            known = 1.0 if run.scale is None else run.scale
            from gsynopsis.scene.load import load_scene

            folder, scale, split = scene_of(replace(run, scale=known), self.scene, self.scale, None)
            scene = load_scene(folder, split, run.reading), positive("--scale", scale)
        with with_training():
            from gsynopsis.evaluation.load_model import open_levels
        opened = open_levels(run.file, self.renderer)
        level = level_of(opened.levels, self.level)
        shots = self._shots(opened.levels, scene)
        with ticking(f"rendering L{level}", quiet=self.quiet) as tick:
            written = self._draw(opened, level, shots, tick)
        if scene and not self.quiet:
            print(scene[0].account.text(), file=sys.stderr)
        print("\n".join(map(str, written)))
        return 0

    def _check(self) -> None:
        if self.out is None and self.flight is None:
            raise SettingError("--out", found="nothing", expected="a folder, or --flight FILE")
        if self.views is not None and self.orbit is not None:
            raise SettingError("--views", found="--orbit as well", expected="one of the two")
        for option, value, limits in (
            ("--orbit", self.orbit, PICTURES),
            ("--width", self.width, SIDE),
            ("--height", self.height, SIDE),
            ("--fps", self.fps, FPS),
        ):
            if value is not None:
                bounded(option, value, *limits)
        if self.flight is not None:
            check_flight(self.flight)

    def _shots(self, levels: "LevelSet", scene: "tuple[Scene, float] | None") -> list[Shot]:
        if scene is not None and self.orbit is None:
            shots = view_shots(*scene, self.views or "test")
        else:
            lens, circle = flight_path(levels, scene)
            circle = replace(circle, arc=None) if self.all_round else circle
            cameras = orbit(circle, lens, self.orbit or ORBIT)
            shots = [(f"orbit_{number:04d}", camera) for number, camera in enumerate(cameras)]
        shots = [(name, sized(camera, self.width, self.height)) for name, camera in shots]
        for _, camera in shots:
            # Of one side the other follows, and a scale below 1 enlarges the photos.
            bounded("width of a picture", camera.width, *SIDE)
            bounded("height of a picture", camera.height, *SIDE)
        return shots

    def _draw(self, opened: "Opened", level: int, shots: Sequence[Shot], tick: Tick) -> list[Path]:
        import torch

        from gsynopsis.evaluation.protocols import LevelRenderer

        painter = LevelRenderer(opened.decoder, opened.renderer)
        written: list[Path] = []
        frames: list[Image8] = []
        for done, (name, camera) in enumerate(shots, start=1):
            with torch.no_grad():
                image = painter.paint(camera, level)
            if self.out is not None:
                written.append(write_png(image, self.out / f"{name}_L{level}.png"))
            if self.flight is not None:
                frames.append(image)
            tick(done, len(shots))
        if self.flight is not None:
            write_flight(frames, self.flight, self.fps)
            written.append(self.flight)
        return written


def level_of(levels: "LevelSet", wanted: int | None) -> int:
    """The number of the level to draw.

    Raises:
        SettingError: the file has no such level.
    """
    last = len(levels.levels) - 1
    if wanted is None:
        return last
    if not 0 <= wanted <= last:
        raise SettingError("--level", found=wanted, expected=f"0 to {last}")
    return wanted


def view_shots(scene: "Scene", scale: float, which: Literal["test", "train", "all"]) -> list[Shot]:
    """The cameras of a scene's own views; a view in a subfolder gets a flat name."""
    chosen = {"test": scene.test, "train": scene.train, "all": range(len(scene.views))}[which]
    names = flat_names([view.name for view in scene.views])
    return [(names[view], scene.camera(view, scale)) for view in chosen]


def flat_names(names: Sequence[str]) -> list[str]:
    """A name without folders and suffix for each photo, all distinct.

    Names that would be equal, as `a/b.png` and `a_b.jpg`, get numbers from 2 on.
    """
    plain = [(name.rpartition(".")[0] or name).replace("/", "_") for name in names]
    taken, found = {name.lower() for name in plain}, list[str]()
    used = set[str]()
    for name in plain:
        unique, number = name, 1
        # Some file systems do not tell A from a.
        while unique.lower() in used or (number > 1 and unique.lower() in taken):
            number += 1
            unique = f"{name}_{number}"
        used.add(unique.lower())
        found.append(unique)
    return found


def flight_path(levels: "LevelSet", scene: "tuple[Scene, float] | None") -> tuple[Camera, Circle]:
    """Lens and circle of an orbit: those of the scene's training cameras if they are known."""
    if scene is None:
        return default_lens(), circle_of_levels(levels)
    known = [scene[0].camera(view, scene[1]) for view in scene[0].train]
    return known[0], circle_of_cameras(known)


def write_png(image: "Image8", path: Path) -> Path:
    """One image, lossless."""
    with published(path) as draft:
        Image.fromarray(image).save(draft)
    return path
