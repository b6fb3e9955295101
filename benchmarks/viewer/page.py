"""The viewer's page in headless Chromium, for docs/results/viewer.md: agreement, times, memory.

    OMP_NUM_THREADS=1 python -m benchmarks.viewer.page --file runs/bonsai/scene.gsyn
    OMP_NUM_THREADS=1 python -m benchmarks.viewer.page --pictures runs/demo/run/scene.gsyn

Chromium draws with SwiftShader. `--file` is measured and its table put into the page; of
`--pictures` all levels are joined into docs/viewer_levels.png. Needs node, Chromium and
`npm ci` in viewer/.
"""

import hashlib
import json
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmarks.bench import RESULTS, ROOT, machine, put, short_commit
from benchmarks.viewer.browser import MISSING, pages, pixels, psnr, visit
from benchmarks.viewer.node import standalone
from gsynopsis.container import Assembler, decode
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import LevelSet
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.page import FOLDER

NOTE, JOINED = RESULTS / "viewer.md", ROOT / "docs" / "viewer_levels.png"
LISTEN = (Path(__file__).parent / "listen.js").read_text()
DECODE = (Path(__file__).parent / "decode.js").read_text()
CAMERA = "(globalThis.fixed ??= (viewer().scene.visit({turn}), viewer().scene.pinhole()))"
MEMORY = "viewer().scene.memory"
MIB = 2**20


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        file: The file to measure.
        pictures: The file whose levels are shown in images.
        repeats: Visits that are timed, and decodings in a worker.
        width: Width of the page, pixels.
        height: Height of the page, pixels.
        turn: The camera's place on the circle of the capture's cameras, 0 to 1.
        json: Print all figures as JSON.
    """

    file: Path | None = None
    pictures: Path | None = None
    repeats: int = 5
    width: int = 600
    height: int = 450
    turn: float = 0.0
    json: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the page."""
        return self.width, self.height


@dataclass(frozen=True)
class Shots:
    """One camera's image of every level, as the page and as the CPU renderer draw it."""

    browser: list[NDArray[np.float64]]
    cpu: list[NDArray[np.float64]]


def shoot(file: Path, levels: LevelSet, options: Options, folder: Path) -> Shots:
    """Render every level."""
    camera = CAMERA.format(turn=options.turn)
    count = len(levels.levels)
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "camera", "script": camera}]
    steps += [{"name": f"L{k}", "script": f"picture({camera}, {k})"} for k in range(count)]
    with pages(file) as address:
        found = visit(f"{address}/?noui", folder, steps, options.size).results
    seen = found["camera"]
    w2c = np.vstack([np.reshape(seen.pop("w2c"), (3, 4)), [0, 0, 0, 1]])
    pose = Camera(**seen, w2c=w2c)
    model, drawn = model_from_levels(levels), list[NDArray[np.float64]]()
    for k in range(count):
        with torch.no_grad():
            image = CpuRenderer().render(model.decode(pose, k), pose, torch.zeros(3)).image
        drawn.append(image.clamp(0, 1).numpy().astype(np.float64))
    return Shots([pixels(found[f"L{k}"]) for k in range(count)], drawn)


def base_times(file: Path, options: Options, folder: Path) -> dict[str, Any]:
    """Seconds from the arrival of the base's last byte to decoded and drawn, visit by visit."""
    found: dict[str, Any] = {"decoded_s": [], "on_screen_s": [], "refining_s": []}
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "heard", "script": "heard"}]
    for _ in range(options.repeats):
        with pages(file) as address:
            seen = visit(f"{address}/?noui", folder, steps, options.size, init=LISTEN)
        heard = seen.results["heard"]
        at = {m["level"]: i for i, m in enumerate(heard) if m["type"] == "level-ready"}
        base, last = at[0], at[max(at)]
        # The page counts bytes as they come; so many had come when the base was whole.
        enough = (
            m for m in heard if m["type"] == "progress" and m["bytes"] >= heard[base]["bytes"]
        )
        arrived = next(enough)["at"]
        decoded = next(m["at"] for m in heard if m["type"] == "attributes")
        shown = seen.times("base-ready")[0]["at"]
        pieces = [m["seconds"] for m in heard[base:last] if m["type"] == "attributes"]
        found["decoded_s"].append((decoded - arrived) / 1000)
        found["on_screen_s"].append((shown - arrived) / 1000)
        found["refining_s"].append(sum(pieces))
    return found


def worker_times(file: Path, options: Options, folder: Path) -> dict[str, Any]:
    """Seconds in one worker to read all tables, to decode the finest level, and for another eye."""
    site = shutil.copytree(FOLDER, folder / "site", dirs_exist_ok=True)
    shutil.copy(standalone(), site / "standalone.js")
    with pages(file, site) as address:
        names = {"MODULE": f"{address}/standalone.js", "FILE": f"{address}/{file.name}"}
        names = {**names, "REPEATS": options.repeats}
        text = "".join(f"const {k} = {json.dumps(v)};\n" for k, v in names.items()) + DECODE
        script = (
            "new Promise((done, refuse) => { const worker = new Worker(URL.createObjectURL("
            f"new Blob([{json.dumps(text)}], {{type: 'text/javascript'}})), {{type: 'module'}});"
            "worker.onmessage = ({data}) => done(data);"
            "worker.onerror = (error) => refuse(error.message); })"
        )
        steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "times", "script": script}]
        return visit(f"{address}/?noui&level=0", folder, steps, options.size).results["times"]


def heap(file: Path, options: Options, folder: Path) -> dict[str, Any]:
    """Bytes of page and workers while refining, and after level changes, beside the arrays."""
    finest = "picture(null, 3).then(() => 0)"
    # A picture gives the camera back, after which all is decoded for it again.
    quiet = {"sleep": 2500}
    coarsest = "picture(null, 0).then(() => 0)"
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        quiet,
        {"heap": "first"},
        {"name": "arrays", "script": MEMORY},
    ]
    for k in range(10):
        steps.append({"name": "_", "script": finest if k % 2 else coarsest})
        if k == 1:
            steps += [quiet, {"heap": "two"}]
    steps += [quiet, {"heap": "ten"}, {"name": "arrays_ten", "script": MEMORY}]
    with pages(file) as address:
        found = visit(f"{address}/?noui", folder, steps, options.size, heap=True).results
    arrays, after = found["arrays"], found["arrays_ten"]
    return {
        "arrays": arrays["tables"] + arrays["decoded"],
        "arrays_after_ten": after["tables"] + after["decoded"],
        "kernel": arrays["kernel"],
        "peak": found["first"]["peak"],
        "complete": found["first"],
        "after_two": found["two"],
        "after_ten": found["ten"],
    }


def join(shots: Shots, data: bytes) -> None:
    """All levels side by side, each with a line of text."""
    width, strip = 300, 24
    pictures = [Image.fromarray((255 * p).round().astype(np.uint8)) for p in shots.browser]
    height = round(width * pictures[0].height / pictures[0].width)
    sheet = Image.new("RGB", (width * len(pictures), height + strip), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for k, (picture, level) in enumerate(
        zip(pictures, Assembler(data, "file").index.levels, strict=True)
    ):
        sheet.paste(picture.resize((width - 4, height), Image.Resampling.LANCZOS), (k * width, 0))
        text = f"L{k}: {level.end / MIB:.2f} MiB, {level.live:,} splats"
        pen.text((k * width + 6, height + 4), text, fill="black", font=font)
    sheet.quantize(256).save(JOINED, optimize=True)


def measure(options: Options, file: Path, folder: Path) -> dict[str, Any]:
    """All figures of a file."""
    load = os.getloadavg()[0]
    data = file.read_bytes()
    levels = decode(data, file.name)
    shots = shoot(file, levels, options, folder)
    agreement = [psnr(*pair) for pair in zip(shots.browser, shots.cpu, strict=True)]
    last = Assembler(data, file.name).index.levels[-1]
    return {
        "scene": levels.meta.get("scene", file.stem),
        "file": file.name,
        "sha256": hashlib.sha256(data).hexdigest(),
        "bytes": len(data),
        "anchors": last.anchors,
        "slots": last.live,
        "size": options.size,
        "agreement_db": agreement,
        "visits": base_times(file, options, folder),
        "worker": worker_times(file, options, folder),
        "heap": heap(file, options, folder),
        "machine": machine().cpu,
        "cores": os.cpu_count(),
        "load": [load, os.getloadavg()[0]],
        "commit": short_commit(),
    }


def spread(values: list[float]) -> str:
    return f"{median(values):.2f} ({min(values):.2f} … {max(values):.2f})"


def table(found: dict[str, Any]) -> str:
    """The note's tables."""
    visits, worker, heap = found["visits"], found["worker"], found["heap"]
    width, height = found["size"]
    peak, complete, ten = heap["peak"], heap["complete"], heap["after_ten"]
    times = [
        ("base's last byte → L0 decoded, worker's clock", visits["decoded_s"]),
        ("base's last byte → L0 on screen", visits["on_screen_s"]),
        (
            "L1 … L3 block by block as they came, in all, with what the worker read meanwhile",
            visits["refining_s"],
        ),
        ("one worker, alone: all tables read (inflate, checks)", worker["read"]),
        (f"one worker, alone: {found['anchors']:,} anchors decoded from nothing", worker["decode"]),
        ("the same again for another eye (heads only)", worker["view"]),
    ]
    memory = [
        ("highest while refining to L3, garbage included", peak["total"]),
        ("after it, collected", complete["total"]),
        ("after two level changes", heap["after_two"]["total"]),
        ("after ten", ten["total"]),
    ]
    held = "; ".join(f"{n} {v / MIB:.1f} ({v / heap['arrays']:.2f} ×)" for n, v in memory)
    agreement = " / ".join(f"{value:.1f}" for value in found["agreement_db"])
    lines = [
        f"| seconds, median of {len(visits['decoded_s'])} (least … most) | |",
        "|---|---|",
        *(f"| {name} | {spread(values)} |" for name, values in times),
        "",
        f"PSNR to the CPU renderer's picture, L0 to L{len(found['agreement_db']) - 1}: {agreement} "
        f"dB. Memory of page and workers, MiB: tables and decoded arrays {heap['arrays'] / MIB:.1f}"
        f"; {held}. {complete['wasm'] / MIB:.1f} MiB of it are WebAssembly's; the highest is of "
        f"{peak['samples']} looks; textures belong to the GPU process and do not count.",
        "",
        f"{found['scene']}: {found['file']} of {found['bytes']:,} bytes (sha256 "
        f"{found['sha256'][:12]}), {found['anchors']:,} anchors, "
        f"{found['slots']:,} splats at L3; page of {width} × {height}; {found['cores']} cores of "
        f"{found['machine']}, load {found['load'][0]:.1f} to {found['load'][1]:.1f} by other work "
        f"and this; commit {found['commit']}. Chromium draws with SwiftShader, on the CPU too.",
    ]
    return "\n".join(lines)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if MISSING:
        sys.exit(f"no {MISSING}: nothing measured")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.pictures:
            data = options.pictures.read_bytes()
            levels = decode(data, options.pictures.name)
            join(shoot(options.pictures, levels, options, folder), data)
            print(f"wrote {JOINED}", file=sys.stderr)
        if options.file:
            found = measure(options, options.file, folder)
            put(NOTE, __file__, table(found))
            print(json.dumps(found, indent=1) if options.json else table(found))
            print(f"wrote {NOTE}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
