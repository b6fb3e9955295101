"""`gsynopsis import`: Gaussians that another program trained, as a nested file."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.cli.bounds import with_training
from gsynopsis.cli.defaults import said
from gsynopsis.cli.splat_options import AskedCameras, AskedUp, asked_up
from gsynopsis.errors import InputError, printable
from gsynopsis.evaluation.formatting import size
from gsynopsis.stream.download import is_address, name_of


@dataclass(frozen=True)
class Import:
    """Make a nested file of the splats of another program.

    Attributes:
        file: PLY (3DGS, 2DGS, SuperSplat, Brush, Postshot, nerfstudio), compressed PLY, SPZ, SOG,
            GLB, USD, .splat, .ksplat, or a lod-meta.json; or the https address of such a file.
        out: The new file; NAME.gsyn beside the file if not given, of an address in this folder.
        levels: Levels of detail at most; the last is the file's own splats, of 4 or more the one
            before it the half that shows most, of 5 or more the one before that the quarter.
        steps: Of training the other levels on renders; 0: these are splats of the file.
        up: Away from the ground, in the axes of the file: x y z, or an axis as +z or -y.
        cameras: Of the training: a cameras.json of 3DGS, a COLMAP model or scene, or a
            transforms.json.
        overwrite: Replace a file that is there.
        json: Print JSON.
        quiet: No progress.
    """

    file: Positional[str]
    out: Annotated[Path | None, said("beside the file")] = None
    levels: int = 6
    steps: int = 500
    up: AskedUp = None
    cameras: AskedCameras = None
    overwrite: bool = False
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Read, rank, write, measure."""
        with with_training():
            from gsynopsis.jobs.import_splats import import_splats
            from gsynopsis.monitor.display import passing
        up = asked_up(self.up)
        named = _named(self.file)
        out = self.out or named.with_suffix(".gsyn")
        with passing(quiet=self.quiet or self.json) as tick:
            made = import_splats(
                self.file if is_address(self.file) else named,
                out,
                self.levels,
                up=up,
                cameras=self.cameras,
                steps=self.steps,
                overwrite=self.overwrite,
                tick=tick,
            )
        if self.json:
            values = {**asdict(made), "path": str(made.path), "sheet": str(made.sheet)}
            print(json.dumps(values, indent=2))
            return 0
        total = size(made.ends[-1])
        print(f"wrote {printable(str(out))} ({total}) from a {made.kind} file")
        for note in made.notes:
            print(f"  {printable(note)}")
        print(f"  what the cameras see: {printable(str(made.sheet))}")
        for level, count in enumerate(made.splats):
            quality = f", {made.psnr[level]:.2f} dB against the input" if made.psnr else ""
            print(f"  level {level}: {count:,} splats, {size(made.ends[level])}{quality}")
        return 0


def _named(file: str) -> Path:
    """The name of a file, folder or address, to name the new one by.

    Raises:
        InputError: it has none.
    """
    if is_address(file):
        return Path(name_of(file))
    # A folder given as . or .. has a name too.
    path = Path(file).resolve() if Path(file).name in ("", "..") else Path(file)
    if not path.name:
        raise InputError(file, found="no name", expected="a file or a named folder")
    return path
