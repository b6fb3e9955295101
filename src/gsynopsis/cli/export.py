"""`gsynopsis export`: levels as files of plain Gaussians, for other programs."""

import json
import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from gsynopsis.cli.bounds import Backend, bounded, positive, with_training
from gsynopsis.cli.defaults import said
from gsynopsis.config import Split
from gsynopsis.errors import SettingError, printable
from gsynopsis.evaluation.formatting import size
from gsynopsis.runs.folder import Run, find_run, scene_of

if TYPE_CHECKING:
    from gsynopsis.jobs.export import Exported, Photographed, Stages

STEPS = (0, 100_000)
FormatName = Literal["ply", "compressed-ply", "spz", "spz3", "sog", "ssog", "glb", "usd"]
"""As `jobs.export.Format`, which needs PyTorch."""


@dataclass(frozen=True)
class Export:
    """Write levels as plain Gaussians that other programs open, and what that costs in dB.

    Attributes:
        target: Folder of a run, or a .gsyn file.
        format: Of the files; spz is version 4. ssog (streamed SOG) holds all levels, as a folder,
            or as one file if --out ends with .ssog.
        level: Level of detail, 0 is the coarsest; the finest if not given.
        all_levels: Every level, a file each.
        out: Folder for the files, or the name of the one file.
        sh_degree: Degree of the spherical harmonics, 0 to 3.
        fine_tune: Steps of training on the training photos after baking, which lost some quality
            (docs/export.md); 1000 take a minute or so. Needs the scene's photos.
        antialiased: For programs that draw antialiased: Gaussians look alike at every size of
            the image, not at that of the training alone.
        scene: Folder of the scene; a run knows its own.
        scale: Divide the photos' width and height by this; a run knows its own.
        split: Rule that chooses the held-out photos.
        overwrite: Replace files that are there.
        renderer: Rasteriser; auto takes CUDA where it is there.
        json: Print JSON.
        quiet: No progress.
    """

    target: Positional[Path]
    format: FormatName = "ply"
    level: Annotated[int | None, said("the finest")] = None
    all_levels: bool = False
    out: Annotated[Path | None, said("RUN/export, or beside the file")] = None
    sh_degree: int = 3
    fine_tune: Annotated[int | None, arg(metavar="STEPS"), said("1000 with photos, else 0")] = None
    antialiased: bool = False
    scene: Annotated[Path | None, said("the run's")] = None
    scale: Annotated[float | None, said("the run's")] = None
    split: Annotated[Split | None, said("the run's, else every8")] = None
    overwrite: bool = False
    renderer: Backend = "auto"
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Bake, fine-tune, measure, write, print."""
        if self.level is not None and self.all_levels:
            raise SettingError("--level", found="--all-levels as well", expected="one of the two")
        bounded("--sh-degree", self.sh_degree, 0, 3)
        bounded("--fine-tune", self.fine_tune or 0, *STEPS)
        run = find_run(self.target)
        with with_training():
            from gsynopsis.container import describe
            from gsynopsis.jobs.export import STEPS_DEFAULT, Exporting, export
            from gsynopsis.model.bake import Baking
            from gsynopsis.monitor.display import ticking
        photos = self._photos(run)
        levels = () if self.level is None else (self.level,)
        if self.all_levels:
            levels = tuple(range(len(describe(run.file).levels)))
        steps = (STEPS_DEFAULT if photos else 0) if self.fine_tune is None else self.fine_tune
        baking = Baking(self.sh_degree, self.antialiased)
        exporting = Exporting(self.format, levels, baking, steps, self.overwrite, self.renderer)
        out = self.out or (run.folder / "export" if self.target.is_dir() else run.folder)
        written = export(run, out, exporting, photos, partial(ticking, quiet=self.quiet))
        if photos and not self.quiet:
            print(photos.scene.account.text(), file=sys.stderr)
        if self.json:
            print(json.dumps([{**asdict(e), "path": str(e.path)} for e in written], indent=2))
            return 0
        print(table(written))
        for exported in written:
            notes = "".join(f" ({note})" for note in exported.notes)
            print(f"wrote {printable(str(exported.path))}{notes}")
        if photos is None:
            print(
                "no photos are known: anchors are baked from cameras around the scene, not measured"
            )
        return 0

    def _photos(self, run: Run) -> "Photographed | None":
        from gsynopsis.jobs.export import photographed

        if self.scene is None and run.scene is None:
            return None
        folder, scale, split = scene_of(run, self.scene, self.scale, self.split)
        return photographed(folder, positive("--scale", scale), split)


def table(written: "list[Exported]") -> str:
    """Gaussians, size and quality of each file."""
    heads = ("level", "Gaussians", "size", "dB of the level", "baked", "fine-tuned")
    rows = [heads] + [
        (f"L{e.level}", f"{e.gaussians:,}", size(e.bytes), *_decibels(e.stages)) for e in written
    ]
    widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
    lines = ["  ".join(v.rjust(w) for v, w in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(lines)


def _decibels(stages: "Stages | None") -> tuple[str, str, str]:
    if stages is None:
        return "-", "-", "-"
    tuned = "-" if stages.tuned is None else f"{stages.tuned:.2f}"
    return f"{stages.anchors:.2f}", f"{stages.baked:.2f}", tuned
