"""Scenes divided into blocks: quality near the borders and away from them, bytes, time.

    python -m benchmarks.train.blocks --out RUNS

Trains a procedural city and brighton in blocks, as one training of the same steps, and, if asked
to, as one of as many steps as the whole and all blocks have together; then renders the held-out
photos and sorts their pixels by what they show: anchors next to a border of two blocks, or others.
As a control it does so by the borders of other divisions too, which no training knew. Rows go to
docs/results/blocks.csv, their table into scale.md. What is trained already is kept.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor

import gsynopsis as gs
from benchmarks.bench import DATA, RESULTS, Row, machine, put, short_commit, stored_rows, write_rows
from benchmarks.bench import train as train_one
from gsynopsis.container.reader import read_gsyn
from gsynopsis.evaluation.metrics import to_bytes
from gsynopsis.jobs.plan_blocks import BLOCKS, MARGIN, PLAN, WHOLE
from gsynopsis.jobs.resolve import resolve
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels
from gsynopsis.monitor.display import Display
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.runs.folder import read_run
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.training.sub_scene import INFINITY, Region, extents, split_space
from research.suites.validation_scenes import procedural_scene

CSV, PAGE = RESULTS / "blocks.csv", RESULTS / "scale.md"
MIB = 2**20
TEXT = ("scene", "training", "machine", "commit")


@dataclass(frozen=True)
class Case:
    """A scene, how it is divided, and steps of each training: full model, then levels."""

    scene: str
    scale: float
    blocks: int
    steps: tuple[int, int]


CONTROLS = (5, 6, 7, 11)
"""Blocks of divisions that nothing was trained by."""
CASES = (Case("city", 2, 8, (1000, 1500)), Case("brighton", 4, 3, (1000, 1500)))


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        out: Folder for scenes and runs.
        jobs: Blocks at once.
        only: Names of scenes.
        longer: Train once more, as many steps as the whole and all blocks have together.
        page: Measure nothing, write the page from the CSV.
    """

    out: Path = Path("runs/blocks")
    jobs: int = 2
    only: tuple[str, ...] = ()
    longer: bool = False
    page: bool = False


@dataclass(frozen=True)
class Borders:
    """Borders between blocks.

    Attributes:
        own: Box of each block.
        margins: How far around a face is next to it, float32 [3] of each block.
    """

    own: tuple[Region, ...]
    margins: tuple[tuple[float, float, float], ...]

    def near(self, x: Tensor) -> Tensor:
        """Positions [N, 3] next to a face between blocks, bool [N]."""
        found = torch.zeros(len(x), dtype=torch.bool)
        for box, margin in zip(self.own, self.margins, strict=True):
            inside = box.holds(x)
            for axis in range(3):
                for face in (box.low[axis], box.high[axis]):
                    if np.isfinite(face):
                        found |= inside & ((x[:, axis] - face).abs() < margin[axis])
        return found


def other_borders(model: AnchorModel) -> list[Borders]:
    """As divisions into other numbers of blocks would have them."""
    x = model.placed()[0].numpy()
    found: list[Borders] = []
    for count in CONTROLS:
        own = split_space(x, count)
        held = [x[box.holds(torch.from_numpy(x)).numpy()] for box in own]
        sizes = [(MARGIN * extents(inside)).tolist() for inside in held]
        found.append(Borders(tuple(own), tuple((a, b, c) for a, b, c in sizes)))
    return found


def borders_of(run: Path) -> Borders:
    """As the plan of a run in blocks has them."""
    plan = json.loads((run / BLOCKS / PLAN).read_text("utf-8"))["blocks"]
    own, margins = list[Region](), list[tuple[float, float, float]]()
    for block in plan:
        low, high = _corner(block["own"]["low"], -INFINITY), _corner(block["own"]["high"], INFINITY)
        wide = _corner(block["trained"]["low"], 0.0), _corner(block["trained"]["high"], 0.0)
        own.append(Region(low, high))
        x, y, z = (
            max(
                low[axis] - wide[0][axis] if low[axis] > -INFINITY else 0.0,
                wide[1][axis] - high[axis] if high[axis] < INFINITY else 0.0,
            )
            for axis in range(3)
        )
        margins.append((x, y, z))
    return Borders(tuple(own), tuple(margins))


def _corner(values: list[float | None], infinite: float) -> tuple[float, float, float]:
    x, y, z = (infinite if value is None else value for value in values)
    return x, y, z


def errors_of(
    model: AnchorModel, scene: Scene, scale: float, borders: Borders
) -> tuple[float, float, float, float]:
    """PSNR over all pixels of the held-out photos, over those next to borders, over the others, dB.

    The fourth number is the share of pixels next to borders.
    """
    renderer, black = CpuRenderer(), torch.zeros(3)
    near = borders.near(model.placed()[0]).float()
    errors, sorts = list[Tensor](), list[Tensor]()
    for view in scene.test:
        camera = scene.camera(view, scale)
        with torch.no_grad():
            decoded = model.decode_level(-1, camera)
            image = renderer.render(decoded.gaussians, camera, black).image
            flags = near[decoded.slots // model.slots][:, None].expand(-1, 3).contiguous()
            flagged = replace(decoded.gaussians, colors=flags)
            shown = renderer.render(flagged, camera, black).image[..., 0]
        truth = torch.from_numpy(scene.image(view, scale).copy()).double()
        drawn = torch.from_numpy(np.asarray(to_bytes(image)).copy()).double()
        errors.append(((drawn - truth) / 255).square().mean(dim=2).flatten())
        sorts.append((shown > 0.5).flatten())
    error, border = torch.cat(errors), torch.cat(sorts)
    found = [_db(error), _db(error[border]), _db(error[~border])]
    return found[0], found[1], found[2], float(border.double().mean())


def _db(error: Tensor) -> float:
    return float(-10 * torch.log10(error.mean())) if len(error) else float("nan")


def measure(case: Case, options: Options) -> Iterator[Row]:
    """Train the missing parts of a case; a row for each training."""
    folder = DATA / case.scene
    if case.scene == "city":
        folder = procedural_scene("city", options.out / "scenes")
    scene = load_scene(folder)
    runs = options.out / f"{case.scene}-{case.blocks}"
    full, levels = case.steps
    asked = {"scale": case.scale, "train.steps": full, "levels.steps": levels}
    recipe = resolve("standard", scene, asked)
    with Display() as display:
        kept = {"observer": display, "evaluate": False}
        gs.train(scene, recipe, runs / "blocks", blocks=case.blocks, jobs=options.jobs, **kept)
        train_one(folder, runs / "one", asked, "standard", **kept)
        if options.longer:
            times = case.blocks + 1
            longer = {"train.steps": full * times, "levels.steps": levels * times}
            train_one(folder, runs / "longer", asked | longer, "standard", **kept)
    borders, made = borders_of(runs / "blocks"), machine()
    controls = other_borders(model_from_levels(read_gsyn(runs / "blocks" / WHOLE / "scene.gsyn")))
    for name in ("one", "longer", f"blocks/{WHOLE}", "blocks"):
        if not (runs / name / "run.json").is_file():
            continue
        run = read_run(runs / name)
        levels = read_gsyn(run.file)
        model = model_from_levels(levels)
        every, near, far, share = errors_of(model, scene, case.scale, borders)
        control = [errors_of(model, scene, case.scale, other)[1] for other in controls]
        yield {
            "scene": case.scene,
            "training": name,
            "blocks": case.blocks,
            "test_photos": len(scene.test),
            "train_photos": len(scene.train),
            "width": scene.camera(scene.test[0], case.scale).width,
            "height": scene.camera(scene.test[0], case.scale).height,
            "seed": recipe.config.train.seed,
            "steps": run.steps,
            "anchors": levels.levels[-1].anchors,
            "bytes": run.file.stat().st_size,
            "psnr": round(every, 3),
            "psnr_border": round(near, 3),
            "psnr_middle": round(far, 3),
            "psnr_control": round(float(np.mean(control)), 3),
            "border_share": round(share, 4),
            "seconds": round(run.train_seconds or 0.0, 1),
            "machine": f"{made.cpu}, {made.cores} cores",
            "commit": short_commit(),
        }


NAMES = {
    "one": "one training",
    "longer": "one training, as many steps as all blocks",
    f"blocks/{WHOLE}": "the whole, before the blocks",
    "blocks": "in blocks",
}


def table(rows: list[Row]) -> str:
    """All scenes as one table, and where they were measured."""
    head = (
        "| scene | training | anchors | MiB | dB | next to borders, dB | elsewhere, dB |"
        " next to other borders, dB | steps | training, s |\n"
        "|---|---|---|---|---|---|---|---|---|---|\n"
    )
    lines = [
        f"| {r['scene']}, {r['blocks']} blocks | {NAMES[r['training']]} | {r['anchors']:,} "
        f"| {r['bytes'] / MIB:.2f} | {r['psnr']:.2f} | {r['psnr_border']:.2f} "
        f"| {r['psnr_middle']:.2f} | {r['psnr_control']:.2f} | {r['steps']:,} "
        f"| {r['seconds']:.0f} |"
        for r in rows
    ]
    about = [
        f"{r['scene']}: {r['train_photos']} photos of {r['width']} × {r['height']} pixels, "
        f"{r['test_photos']} test photos, {r['border_share']:.0%} of their pixels next to borders, "
        f"seed {r['seed']}"
        for r in rows
        if r["training"] == "blocks"
    ]
    made = "; ".join(sorted({f"{r['machine']}, commit {r['commit']}" for r in rows}))
    return head + "\n".join(lines) + f"\n\n{'; '.join(about)}. {made}."


def main() -> None:
    """Measure, keep the rows, write the page."""
    options = tyro.cli(Options)
    if not options.page:
        kept = stored_rows(CSV, TEXT) if CSV.is_file() else []
        for case in CASES:
            if options.only and case.scene not in options.only:
                continue
            rows = list(measure(case, options))
            kept = [r for r in kept if r["scene"] != case.scene] + rows
            write_rows(CSV, kept)
    put(PAGE, __file__, table(stored_rows(CSV, TEXT)))


if __name__ == "__main__":
    main()
