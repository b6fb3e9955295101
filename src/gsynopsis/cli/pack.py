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
        run_path: Folder of a run.
        out: The file; RUN/scene.gsyn if not given.
        coding: `compact` (few bits, live slots only), or `raw` (float32, exact).
        block: Largest number of anchors of a spatial block, 0 for the default. Of smaller ones
            (512 to 1024) a stream can choose what to refine first, for 2 to 4 % more bytes. Those
            of level 0 have 2048 at most in any case.
        licence: What others may do with the scene, as text that the file carries.
        crop: Low corner and high corner of a box, world units: what lies outside is left out.
        up: Away from the ground, in the scene's axes: the viewer stands upright in it.
        quiet: No progress.
    """

    run_path: Positional[Path]
    out: Annotated[Path | None, said("the run's scene.gsyn")] = None
    coding: Literal["raw", "compact"] = "compact"
    block: int = 0
    licence: Annotated[str | None, said("none")] = None
    crop: Annotated[tuple[float, float, float, float, float, float] | None, said("none")] = None
    up: Annotated[tuple[float, float, float] | None, said("as the cameras have it")] = None
    quiet: bool = False

    def run(self) -> int:
        """Load the checkpoint, measure, write the file."""
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
            quiet=self.quiet,
        )
        print(f"wrote {printable(str(path))} ({path.stat().st_size / 2**20:.2f} MiB)")
        return 0
