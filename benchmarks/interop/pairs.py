"""Splats through every pair of formats: read from the first, written as the second, read again.

    python -m benchmarks.interop.pairs FILE.ply --name biker    # into interop.md and pairs.csv

Each cell is PSNR of a picture of what comes out against one of the file at the start, from one
camera that sees all of it upright. What lies on its side, is mirrored or has other colours shows.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, machine, put, short_commit, write_rows
from gsynopsis.container.writer import write_gsyn
from gsynopsis.evaluation.metrics import Image8, psnr
from gsynopsis.formats.axes import half_turned, up_text
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.jobs.export import Exporting, Format, export
from gsynopsis.jobs.import_splats import splat_model
from gsynopsis.jobs.splat_views import painted
from gsynopsis.model.splat_levels import splat_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.runs.folder import find_run
from gsynopsis.scene.camera import Camera, look_at

PAGE, CSV = RESULTS / "interop.md", RESULTS / "pairs.csv"
NAMES: dict[Format, str] = {
    "ply": "PLY",
    "compressed-ply": "compressed PLY",
    "spz": "SPZ 4",
    "spz3": "SPZ 3",
    "sog": "SOG",
    "ssog": "streamed SOG",
    "glb": "GLB",
    "usd": "USD",
}
SIDE = 256
"""Pixels of the picture."""


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        splats: An object, upright by the custom of 3DGS.
        name: Of it, for the page.
    """

    splats: Positional[Path]
    name: str = "an object"


def main() -> None:
    options, rows = tyro.cli(Options, description=__doc__), list[Row]()
    given = read_splats(options.splats)
    camera = before(given)
    truth = picture(given, camera)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for first in NAMES:
            there = read_splats(written(given, first, folder / first))
            for second in NAMES:
                back = read_splats(written(there, second, folder / f"{first}-{second}"))
                count = len(back.levels[-1])
                db = min(100.0, psnr(picture(back, camera), truth))
                rows.append({"from": first, "to": second, "splats": count, "db": round(db, 1)})
                print(rows[-1], flush=True)
    write_rows(CSV, rows)
    put(PAGE, __file__, page(rows, len(given.levels[-1]), options.name))


def before(given: SplatFile) -> Camera:
    """A camera that sees all of an object from the front, a little from above."""
    means = given.levels[-1].means.astype(np.float64)
    low, high = np.quantile(means, (0.02, 0.98), axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    up = np.array([0.0, -1.0, 0.0])
    eye = middle + reach * (np.array([0.3, 0.0, -1.2]) + 0.3 * up)
    lens = (SIDE, SIDE, float(SIDE), float(SIDE), SIDE / 2, SIDE / 2)
    return Camera(*lens, look_at(eye, middle, up))


def picture(found: SplatFile, camera: Camera) -> Image8:
    """Splats as the camera sees them, those of formats with y up turned to the axes of 3DGS."""
    if found.up[1] > 0.5:
        turned = tuple(half_turned(level) for level in found.levels)
        found = SplatFile(turned, found.antialiased, kind=found.kind)
    return painted(splat_model(found), 0, camera, make_renderer("cpu"))


def written(given: SplatFile, name: Format, folder: Path) -> Path:
    """A file of these splats, by way of a `.gsyn` file of one level."""
    folder.mkdir()
    finest = given.levels[-1]
    notes = {"up": up_text(given.up)}
    levels = splat_levels(finest, np.ones(len(finest)), [len(finest)], notes)
    write_gsyn(levels, folder / "a.gsyn")
    (made,) = export(find_run(folder / "a.gsyn"), folder / "out", Exporting(format=name), None)
    return made.path


def page(rows: list[Row], splats: int, name: str) -> str:
    """Ranges of dB that each format keeps of all others, and their protocol."""
    kept = {text: [row["db"] for row in rows if row["to"] == to] for to, text in NAMES.items()}
    ranges = [f"{text} {min(db):.1f} to {max(db):.1f}" for text, db in kept.items()]
    return (
        f"From all {len(NAMES)} formats into {', '.join(ranges)} dB. {splats:,} splats ({name}), "
        f"one camera of {SIDE} × {SIDE}; {machine().cpu}, commit {short_commit()}."
    )


if __name__ == "__main__":
    main()
