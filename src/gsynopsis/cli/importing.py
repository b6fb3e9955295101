"""`gsynopsis import`: Gaussians that another program trained, as a nested file."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.cli.bounds import with_training
from gsynopsis.cli.defaults import said
from gsynopsis.errors import printable
from gsynopsis.evaluation.phrases import size


@dataclass(frozen=True)
class Import:
    """Make a nested file of the splats of another program.

    Attributes:
        file: PLY (3DGS, SuperSplat, Brush, Postshot), compressed PLY, SPZ, SOG, or a
            lod-meta.json.
        out: The new file; NAME.gsyn beside the file if not given.
        levels: Levels of detail, where the file has none of its own.
        overwrite: Replace a file that is there.
        json: Print JSON.
        quiet: No progress.
    """

    file: Positional[Path]
    out: Annotated[Path | None, said("beside the file")] = None
    levels: int = 4
    overwrite: bool = False
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Read, rank, write, measure."""
        with with_training():
            from gsynopsis.pipeline.importing import import_splats
            from gsynopsis.pipeline.progress import passing
        out = self.out or self.file.with_suffix(".gsyn")
        with passing(quiet=self.quiet or self.json) as tick:
            made = import_splats(self.file, out, self.levels, overwrite=self.overwrite, tick=tick)
        if self.json:
            print(json.dumps({**asdict(made), "path": str(made.path)}, indent=2))
            return 0
        print(f"wrote {printable(str(out))} ({size(made.ends[-1])}) from a {made.kind} file")
        for level, count in enumerate(made.splats):
            quality = f", {made.psnr[level]:.2f} dB against the input" if made.psnr else ""
            print(f"  level {level}: {count:,} splats, {size(made.ends[level])}{quality}")
        for note in made.notes:
            print(note)
        return 0
