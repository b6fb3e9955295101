"""Programs that open files of `gsynopsis export`, and the distance of their renders from ours.

    python -m benchmarks.interop.matrix --run runs/scenes/fox-fast
    python -m benchmarks.interop.matrix --gaussians runs/interop/scene_L3.ply

A level is baked and fine-tuned as by `gsynopsis export`, and written in all formats. Each program
opens each file. Programs that render do so in headless Chromium (SwiftShader) from the camera of a
held-out photo at the size of the run's images; Gaussians that the others read are rendered by our
rasteriser. All images are compared with that of the Gaussians before they were written. Needs node,
Chromium and `npm ci` in benchmarks/interop; a cell names what is missing.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from PIL import Image

import benchmarks.bench as bench
from benchmarks.bench import RESULTS, Row, put, stored_rows, write_rows
from benchmarks.interop import readers
from benchmarks.interop.kernels import KERNELS, painted
from benchmarks.viewer.browser import CHROMIUM
from benchmarks.viewer.node import NODE
from gsynopsis.evaluation.load_model import open_levels
from gsynopsis.evaluation.metrics import Image8, psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.formats.axes import half_turned
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.glb import EXTENSION
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.formats.writers.ssog import INDEX, ssog_files
from gsynopsis.jobs.export import (
    ENDINGS,
    STEPS_DEFAULT,
    Exporting,
    Format,
    Photographed,
    bake_level,
    encoded,
)
from gsynopsis.model.plain import PlainModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.runs.folder import find_run, scene_of
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene

CSV, PAGE = RESULTS / "interop.csv", RESULTS / "interop.md"
FORMATS: dict[Format, str] = {
    "ply": "PLY",
    "compressed-ply": "compressed PLY",
    "spz3": "SPZ 3",
    "spz": "SPZ 4",
    "sog": "SOG",
    "ssog": "streamed SOG",
    "glb": "GLB",
    "usd": "USD",
}
READERS = ("splat-transform", "gaussforge", "gsply", "usd-core", "glTF-Validator")
DRAWERS = {"playcanvas": "PlayCanvas", "spark": "Spark", "babylon": "Babylon.js"}
SPZ: tuple[Format, ...] = ("spz", "spz3")
OPENED: Mapping[str, tuple[Format, ...]] = {
    "splat-transform": ("ply", "compressed-ply", *SPZ, "sog", "ssog"),
    "gaussforge": ("ply", "compressed-ply", *SPZ, "sog"),
    "gsply": ("ply", "compressed-ply", *SPZ),
    "usd-core": ("usd",),
    "glTF-Validator": ("glb",),
    "playcanvas": ("ply", "compressed-ply", "sog", "ssog", "glb"),
    "spark": ("ply", "compressed-ply", *SPZ, "sog"),
    "babylon": ("ply", "compressed-ply", *SPZ, "sog", "ssog", "glb"),
}
"""Formats that each program says it reads."""
BAR = 35.0
"""dB between another program's image and ours."""
THINNER = 0.075
"""Square pixels that PlayCanvas and Babylon.js add to a splat's variance; 3DGS adds 0.3."""
UNKNOWN = "MESH_PRIMITIVE_INVALID_ATTRIBUTE"
TEXT = ("format", "reader", "said", "machine", "commit")


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        run: Folder of a run.
        gaussians: PLY of the level, from an earlier call; written there if it is missing.
        level: Level of detail.
        only: Programs; all if empty.
        formats: Formats; all if empty.
        out: Folder in which files and images stay; a temporary one if not given. Existing files are
            not written again.
    """

    run: Path = bench.RUNS / "scenes" / "fox-fast"
    gaussians: Path | None = None
    level: int = 3
    only: tuple[str, ...] = ()
    formats: tuple[Format, ...] = ()
    out: Path | None = None


@dataclass(frozen=True)
class Stage:
    """Gaussians that files are written from and compared with.

    Attributes:
        folder: Folder of the files.
        gaussians: Before they were written.
        camera: Camera of a held-out photo.
        truth: Our render of them.
    """

    folder: Path
    gaussians: PlainGaussians
    camera: Camera
    truth: Image8


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    with tempfile.TemporaryDirectory() as name:
        folder = options.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        stage = staged(options, folder.resolve())
        wanted: tuple[Format, ...] = options.formats or tuple(FORMATS)
        files: dict[Format, Path] = {name: written(stage, name) for name in wanted}
        rows = stored_rows(CSV, TEXT) if CSV.exists() else []
        for row in measured(stage, files, options.only or (*DRAWERS, *READERS)):
            print(row, file=sys.stderr, flush=True)
            key = (row["reader"], row["format"])
            rows = [r for r in rows if (r["reader"], r["format"]) != key] + [row]
            rows.sort(key=lambda r: ([*FORMATS].index(r["format"]), r["reader"]))
            write_rows(CSV, rows)
            put(PAGE, __file__, table(rows, stage))


def staged(options: Options, folder: Path) -> Stage:
    """The level's Gaussians, a camera and our picture."""
    run = find_run(options.run)
    source, scale, split = scene_of(run, None, None, None)
    scene = load_scene(source, split)
    kept = options.gaussians or folder / "gaussians.ply"
    if not kept.is_file():
        opened = open_levels(run.file)
        exporting = Exporting(steps=STEPS_DEFAULT)
        baked = bake_level(opened, options.level, exporting, Photographed(scene, scale))
        kept.write_bytes(ply_bytes(baked.gaussians))
    gaussians = read_splats(kept).levels[-1]
    camera = scene.camera(scene.test[0], scale)
    return Stage(folder, gaussians, camera, picture(gaussians, camera))


def picture(gaussians: PlainGaussians, camera: Camera) -> Image8:
    """Ours, as in 3DGS, on black."""
    painter = LevelRenderer(PlainModel(gaussians, antialiased=False), CpuRenderer())
    with torch.no_grad():
        return painter.paint(camera, 0)


def written(stage: Stage, name: Format) -> Path:
    """A file of the format; of streamed SOG the index, with a coarser level of half of them."""
    if name != "ssog":
        path = stage.folder / f"fox{ENDINGS[name]}"
        if not path.is_file():
            path.write_bytes(encoded(stage.gaussians, name, False))
        return path
    index = stage.folder / "ssog" / INDEX
    if index.is_file():
        return index
    opacities = -stage.gaussians.logits
    half = np.sort(np.argsort(opacities)[: len(stage.gaussians) // 2])
    g = stage.gaussians
    coarse = PlainGaussians(
        g.means[half], g.log_scales[half], g.quaternions[half], g.logits[half], g.sh[half]
    )
    return write_ssog([coarse, g], stage.folder / "ssog", [0.1, 0.0])


def write_ssog(
    levels: Sequence[PlainGaussians], folder: Path, errors: Sequence[float] | None = None
) -> Path:
    """A folder of streamed SOG, coarse to fine, its index last; where that is."""
    files = ssog_files(levels, errors)
    for inner, data in reversed(files.items()):
        path = folder / inner
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder / INDEX


def measured(
    stage: Stage, files: Mapping[Format, Path], programs: tuple[str, ...]
) -> Iterator[Row]:
    """A row for each program and each format that it reads."""
    facts = {"machine": bench.machine().cpu, "commit": bench.short_commit()}
    blank = {"count": "", "psnr": "", "thinner": "", "said": ""}
    for reader in programs:
        names: list[Format] = [name for name in OPENED[reader] if name in files]
        if reader in DRAWERS:
            chosen: dict[Format, Path] = {name: files[name] for name in names}
            found = drawn(stage, reader, chosen)
        else:
            found = {name: read(stage, reader, name, files[name]) for name in names}
        for name, result in found.items():
            yield {"format": name, "reader": reader, **blank, **result, **facts}


def read(stage: Stage, reader: str, name: Format, path: Path) -> Row:
    """Gaussians that a program without a renderer reads from a file."""
    if lacking := readers.missing(reader):
        return {"said": f"not run: no {lacking}"}
    ways: dict[str, Callable[[], PlainGaussians]] = {
        "splat-transform": partial(readers.by_splat_transform, path, stage.folder),
        "gaussforge": partial(readers.by_gaussforge, path, name, stage.folder),
        "gsply": partial(readers.by_gsply, path, name),
        "usd-core": partial(readers.by_usd, path),
    }
    try:
        if reader == "glTF-Validator":
            return verdict(readers.validated(path))
        found = ways[reader]()
    except Exception as error:  # whatever a program of others throws is its result
        return {"said": f"{type(error).__name__}: {error}"[:200]}
    if name in SPZ:
        found = half_turned(found)  # values of SPZ have y up
    return {"count": len(found), "psnr": decibels(picture(found, stage.camera), stage.truth)}


def verdict(report: dict[str, Any]) -> Row:
    """Errors, without those that say only that the validator does not know the extension."""
    issues = report["issues"]
    unknown = [m for m in issues["messages"] if m["code"] == UNKNOWN and EXTENSION in m["pointer"]]
    errors = issues["numErrors"] - len(unknown)
    said = f"{errors} errors; it does not know {len(unknown)} names of the extension's attributes"
    return {"count": report["info"]["totalVertexCount"], "said": said}


def drawn(stage: Stage, engine: str, files: Mapping[Format, Path]) -> dict[Format, Row]:
    """Renders of files by another program, in Chromium."""
    if not (NODE and CHROMIUM and (readers.MODULES / "esbuild").is_dir()):
        said = "not run: needs node, Chromium and npm ci in benchmarks/interop"
        return {name: {"said": said} for name in files}
    jobs = [
        {
            "name": f"{engine}_{name}",
            "engine": engine,
            "format": name,
            "url": path.relative_to(stage.folder).as_posix(),
            "camera": lens(stage.camera, turned=name in (*SPZ, "glb")),
        }
        for name, path in files.items()
    ]
    request = stage.folder / f"{engine}.json"
    request.write_text(
        json.dumps(
            {
                "chromium": CHROMIUM,
                "folder": str(stage.folder),
                "out": str(stage.folder),
                "jobs": jobs,
            }
        )
    )
    command = [str(NODE), str(readers.HERE / "pages.mjs"), str(request)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=1800, check=True)
    results: dict[str, Any] = json.loads(done.stdout)
    own = thinner(stage, engine)
    rows: dict[Format, Row] = {}
    for name in files:
        found = results[f"{engine}_{name}"]
        if "error" in found:
            rows[name] = {"said": found["error"]}
            continue
        image = np.asarray(Image.open(stage.folder / f"{engine}_{name}.png").convert("RGB"))
        rows[name] = {"count": found["count"], "psnr": decibels(image, stage.truth)}
        rows[name] |= {"thinner": decibels(image, own)} if own is not None else {}
    return rows


def thinner(stage: Stage, engine: str) -> Image8 | None:
    """Our image with the kernel and the dilation of a program that has others than 3DGS."""
    if engine not in KERNELS:
        return None
    kept = stage.folder / f"{engine}_kernel.png"
    if not kept.is_file():
        image = painted(stage.gaussians, stage.camera, engine, THINNER)
        Image.fromarray(image).save(kept)
    return np.asarray(Image.open(kept).convert("RGB"))


def lens(camera: Camera, *, turned: bool) -> dict[str, Any]:
    """A camera for pages; `turned`: in the axes of files with y up."""
    half = np.diag([1.0, -1.0, -1.0, 1.0]) if turned else np.eye(4)
    names = ("width", "height", "fx", "fy", "cx", "cy")
    return {
        **{name: getattr(camera, name) for name in names},
        "w2c": (camera.w2c @ half)[:3].ravel().tolist(),
    }


def decibels(found: NDArray[np.uint8], truth: Image8) -> float:
    return round(float(psnr(found, truth)), 2)


def table(rows: list[Row], stage: Stage) -> str:
    """Markdown: a row for each program, a column for each format; notes below."""
    found = {(row["reader"], row["format"]): row for row in rows}
    lines = ["| | " + " | ".join(FORMATS.values()) + " |", "|---" * (len(FORMATS) + 1) + "|"]
    notes: list[str] = []
    for reader in (*DRAWERS, *READERS):
        cells = [cell(found.get((reader, name)), len(stage.gaussians), notes) for name in FORMATS]
        lines.append(f"| {DRAWERS.get(reader, reader)} | " + " | ".join(cells) + " |")
    camera = stage.camera
    pictured = [row for row in rows if row["reader"] in DRAWERS] or rows
    where = sorted({f"{row['machine']}, commit {row['commit']}" for row in pictured})
    facts = (
        f"{len(stage.gaussians):,} splats, one camera of {camera.width} × {camera.height}, "
        f"dB; {'; '.join(where)}."
    )
    return "\n".join([*lines, "", *(f"{i}. {note}" for i, note in enumerate(notes, 1)), "", facts])


def cell(row: Row | None, count: int, notes: list[str]) -> str:
    """One result: decibels, what else was said as a note."""
    if row is None:
        return "-"
    if row["psnr"] == "":
        if row["count"] == count:
            return str(row["said"])
        notes.append(str(row["said"]))
        return f"fails ({len(notes)})"
    text = f"{row['psnr']:.1f}" if row["psnr"] >= BAR else f"**{row['psnr']:.1f}**"
    if row.get("thinner", "") != "":
        text += f", {row['thinner']:.1f}"
    if row["count"] != count:
        notes.append(f"{row['count']:,} splats of {count:,}")
        text += f" ({len(notes)})"
    return text


if __name__ == "__main__":
    main()
