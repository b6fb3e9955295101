"""`gsynopsis pack`: write a run's levels as one file again, in either coding."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gsynopsis.cli.bounds import with_training
from gsynopsis.cli.defaults import said
from gsynopsis.errors import printable


@dataclass(frozen=True)
class Pack:
    """Pack a finished run into one progressive file.

    Attributes:
        run_path: Folder of a run; with --notes, a .gsyn file too.
        out: The file; RUN/scene.gsyn if not given.
        coding: `compact` (few bits, live slots only), or `raw` (float32, exact).
        block: Largest number of anchors of a spatial block, 0 for the default. Of smaller ones
            (512 to 1024) a stream can choose what to refine first, for 2 to 4 % more bytes. Those
            of level 0 have 2048 at most in any case.
        licence: What others may do with the scene, as text that the file carries.
        crop: Low corner and high corner of a box, world units: what lies outside is left out.
        up: Away from the ground, in the scene's axes: the viewer stands upright in it.
        notes: Annotations as the viewer saves them, JSON, in place of those in the file; without
            it those stay. For a .gsyn file they alone are written.
        quiet: No progress.
    """

    run_path: Positional[Path]
    out: Annotated[Path | None, said("the run's scene.gsyn")] = None
    coding: Literal["raw", "compact"] = "compact"
    block: int = 0
    licence: Annotated[str | None, said("none")] = None
    crop: Annotated[tuple[float, float, float, float, float, float] | None, said("none")] = None
    up: Annotated[tuple[float, float, float] | None, said("as the cameras have it")] = None
    notes: Annotated[Path | None, said("those in the file")] = None
    quiet: bool = False

    def run(self) -> int:
        """Load the checkpoint, measure, write the file."""
        if self.notes is not None and self.run_path.is_file():
            return self._annotate(self.run_path, self.notes)
        with with_training():
            from gsynopsis.jobs.pack import pack
        path = pack(
            self.run_path,
            self.out,
            coding=self.coding,
            block=self.block,
            licence=self.licence or "",
            crop=self.crop,
            up=self.up,
            notes=self.notes,
            quiet=self.quiet,
        )
        print(f"wrote {printable(str(path))} ({path.stat().st_size / 2**20:.2f} MiB)")
        return 0

    def _annotate(self, file: Path, notes: Path) -> int:
        """Put annotations into a file that is no run's."""
        from gsynopsis.container.annotate import annotate, read_annotations

        out = self.out or file
        annotate(file, read_annotations(notes), notes, out)
        print(f"wrote {printable(str(out))} ({out.stat().st_size / 2**20:.2f} MiB)")
        return 0
