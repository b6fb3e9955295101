"""Curves of `gsynopsis unfold` on splat files, beside `import` and files of other formats.

    python -m benchmarks.unfold.run OUT biker=FILE.ply garden=FILE.ply [--steps 250 1000]
    python -m benchmarks.unfold.run OUT garden=FILE.ply --imports

Every figure is against renders of the input from the same views, which nothing was trained on and
no setting was chosen by (the part `test` of RUN/renders; settings are chosen by the part `val`).
Inputs that are not there are named and left out. With `--imports` those of an earlier run are
imported again and nothing else is done. Writes unfold.csv and unfold.md into OUT.
"""

import argparse
import csv
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import torch

from gsynopsis import __version__
from gsynopsis.container.info import describe
from gsynopsis.container.reader import read_gsyn
from gsynopsis.errors import GsynopsisError
from gsynopsis.evaluation.environment import this_build, this_machine, usable_cores
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import Decoder, LevelRenderer
from gsynopsis.formats.axes import half_turned
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.formats.writers.forge import forge_bytes
from gsynopsis.formats.writers.packed import packed_bytes
from gsynopsis.formats.writers.sog import sog_bytes
from gsynopsis.jobs.fit_stand_ins import STEPS
from gsynopsis.jobs.import_splats import import_splats
from gsynopsis.jobs.unfold_splats import RENDERS
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.records import PlainGaussians
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene

KIB = 1024
IMPORT, THINNED = "import", "import --steps 0"
"""Import as it is, and with coarse levels that are splats of the input."""
OTHERS: dict[str, Callable[[PlainGaussians], bytes]] = {
    "compressed.ply": packed_bytes,
    "spz": lambda gaussians: forge_bytes(gaussians, "spz3"),
    "sog": sog_bytes,
}
"""Writers of other formats by the ending of their files."""


@dataclass(frozen=True)
class Row:
    """One point of a curve."""

    scene: str
    splats: int
    method: str
    level: int
    bytes: int
    db: float
    seconds: float
    mib: float


def main() -> None:
    """Measure all inputs that are there."""
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    missing: list[str] = []
    for text in args.inputs:
        name, _, path = text.partition("=")
        if not Path(path).exists():
            print(f"{name}: skipped, {path} is not there", flush=True)
            missing.append(name)
            continue
        rows += measured(name, Path(path), args)
        write_rows(rows, args.out)
        if not args.imports:
            (args.out / "unfold.md").write_text(page(rows, missing, args))


def arguments() -> argparse.Namespace:
    """Options of the benchmark."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("inputs", nargs="*", help="NAME=FILE")
    parser.add_argument("--views", type=int, default=112)
    parser.add_argument("--steps", type=int, nargs=2, metavar=("FULL", "JOINT"))
    parser.add_argument("--imports", action="store_true", help="of what OUT has renders of, alone")
    return parser.parse_args()


def measured(name: str, path: Path, args: argparse.Namespace) -> list[Row]:
    """All rows of one input."""
    run, given = args.out / name, read_splats(path)
    finest, total = given.levels[-1], len(given.levels[-1])
    if args.imports:
        return imported(name, total, path, run, load_scene(run / RENDERS))
    seconds, peak = unfolded(path, run, args)
    scene = load_scene(run / RENDERS)
    rows = curve(name, total, "unfold", run / "scene.gsyn", scene, seconds, peak)
    rows += imported(name, total, path, run, scene)
    rows += published(name, path, given, scene)
    for method, encoded in OTHERS.items():
        started = time.monotonic()
        try:
            made = encoded(finest)
        except GsynopsisError as error:
            print(f"{name}: no {method}: {error}", flush=True)
            continue
        took = time.monotonic() - started
        db = against(reread(method, made, run), 0, scene)
        rows.append(Row(name, total, method.split(".")[0], 0, len(made), db, took, 0.0))
    return rows


def unfolded(path: Path, run: Path, args: argparse.Namespace) -> tuple[float, float]:
    """Unfold an input; the seconds it took and the most memory, MiB."""
    words = [sys.executable, "-m", "gsynopsis", "unfold", str(path), "--out", str(run)]
    words += ["--views", str(args.views)]
    if args.steps:
        words += ["--train.steps", str(args.steps[0]), "--levels.steps", str(args.steps[1])]
    started = time.monotonic()
    subprocess.run(words, check=True)
    seconds = time.monotonic() - started
    return seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / KIB


def imported(name: str, splats: int, path: Path, run: Path, scene: Scene) -> list[Row]:
    """Rows of both ways to import an input; the files are written into the run."""
    rows, file = list[Row](), run / "import.gsyn"
    for method, steps in ((IMPORT, STEPS), (THINNED, 0)):
        started = time.monotonic()
        import_splats(path, file, steps=steps, overwrite=True)
        took = time.monotonic() - started
        rows += curve(name, splats, method, file, scene, took, 0.0)
    return rows


def published(name: str, path: Path, given: SplatFile, scene: Scene) -> list[Row]:
    """Levels that a streamed SOG came with, in the bytes of its files; each is sent for itself."""
    total, rows = len(given.levels[-1]), list[Row]()
    if path.name != "lod-meta.json":
        return rows
    for level, gaussians in enumerate(given.levels[:-1]):
        # Folders have the number of a level, finest first, and that of a part.
        parts = path.parent.glob(f"{len(given.levels) - 1 - level}_*/*")
        size = sum(part.stat().st_size for part in parts)
        db = against(SplatModel(gaussians), 0, scene)
        rows.append(Row(name, total, "streamed SOG", level, size, db, 0.0, 0.0))
    return rows


def reread(kind: str, made: bytes, folder: Path) -> SplatModel:
    """The splats of a file of another format, which is written into a folder."""
    again = folder / f"again.{kind}"
    again.write_bytes(made)
    own = read_splats(again).levels[-1]
    # Files of SPZ have y up.
    return SplatModel(half_turned(own) if kind == "spz" else own)


def curve(
    name: str, splats: int, method: str, path: Path, scene: Scene, seconds: float, mib: float
) -> list[Row]:
    """The levels of one of our files."""
    model = decoder_of(read_gsyn(path))
    return [
        Row(name, splats, method, level.level, level.bytes, db, seconds, mib)
        for level in describe(path).levels
        for db in (against(model, level.level, scene),)
    ]


def against(model: Decoder, level: int, scene: Scene, factor: float = 1.0) -> float:
    """Mean PSNR against held-out photos, or renders, divided by `factor`, dB."""
    painter = LevelRenderer(model, make_renderer("cpu"))
    with torch.no_grad():
        found = [
            psnr(painter.paint(scene.camera(view, factor), level), scene.image(view, factor))
            for view in scene.test
        ]
    return float(np.mean(found))


def at_bytes(rows: Sequence[Row], size: int) -> float | None:
    """The best of some rows in so many bytes, dB."""
    fitting = [row.db for row in rows if row.bytes <= size]
    return max(fitting) if fitting else None


def write_rows(rows: Sequence[Row], out: Path) -> None:
    """The table."""
    with (out / "unfold.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {**asdict(r), "db": f"{r.db:.2f}", "seconds": f"{r.seconds:.0f}", "mib": f"{r.mib:.0f}"}
            for r in rows
        )


def page(rows: Sequence[Row], missing: Sequence[str], args: argparse.Namespace) -> str:
    """The page about the rows."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    first = [r for r in rows if r.scene == scenes[0] and r.method == "unfold"]
    spz = [r for r in rows if r.scene == scenes[0] and r.method == "spz"]
    share = f", {100 * first[0].bytes / spz[0].bytes:.1f} % of its SPZ" if spz else ""
    text = [
        "# Unfolding a finished splat",
        "",
        f"Level 0 of *{scenes[0]}* has {first[0].db:.1f} dB in {first[0].bytes / KIB:.0f} KiB"
        f"{share}, trained on renders of the input without its photos.",
        "",
        *losses(rows, scenes),
        "",
        "| scene | method | level | KiB | dB | s |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        text.append(
            f"| *{row.scene}*, {row.splats:,} splats | {row.method} | {row.level} | "
            f"{row.bytes / KIB:.0f} | {row.db:.2f} | {row.seconds:.0f} |"
        )
    steps = f" --steps {args.steps[0]} {args.steps[1]}" if args.steps else ""
    named = " ".join(f"{name}=FILE" for name in scenes)
    machine = this_machine(torch.device("cpu"))
    text += [
        "",
        "dB is PSNR against renders of the input from views that nothing was trained on, 480 × "
        "270, 8 bits, on black; where a view is mostly empty that counts too. Seconds are of the "
        "wall, "
        "from file to file, on a machine that others used at the same time. Not run on a GPU.",
        "",
        f"`python -m benchmarks.unfold.run OUT {named} --views {args.views}{steps}`, seed 0, "
        f"gsynopsis {__version__}, commit {this_build().commit}, {machine.cpu}, "
        f"{usable_cores()} cores.",
    ]
    if missing:
        text.append(f"\nNot measured, as the file was not there: {', '.join(missing)}.")
    return "\n".join(text) + "\n"


def losses(rows: Sequence[Row], scenes: Sequence[str]) -> list[str]:
    """Rivals that are better in the bytes of one of our levels, and by how much; else ahead."""
    found: list[str] = []
    for scene in scenes:
        own = [r for r in rows if r.scene == scene and r.method == "unfold"]
        rivals = [r for r in rows if r.scene == scene and r.method not in ("unfold", IMPORT)]
        last = max(own, key=lambda r: r.bytes)
        better = [r for r in rivals if r.db > last.db]
        least = min((r.bytes for r in better), default=None)
        if least is not None:
            found.append(
                f"- *{scene}*: the curve ends at {last.db:.1f} dB; with {least / KIB:,.0f} KiB, "
                f"{least / last.bytes:.1f} times our bytes, rivals are better."
            )
        gains = [(r, at_bytes(rivals, r.bytes)) for r in own]
        lead = [f"L{r.level} {r.db - best:+.1f}" for r, best in gains if best is not None]
        none = [f"L{r.level}" for r, best in gains if best is None]
        words = f"dB over the best rival in as many bytes: {', '.join(lead)}. " if lead else ""
        if none:
            words += f"No rival has a picture in the bytes of {', '.join(none)}."
        found.append(f"- *{scene}*: {words}")
    return found


if __name__ == "__main__":
    main()
