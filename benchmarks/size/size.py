"""The figures of docs/results/size.md: bytes of a file by part, and the loss of coding in dB.

    for scene in fox bonsai; do
        gsynopsis train $scene --scale 4 --set levels.coding_loss=0 \
            --out runs/exact/$scene-fast
    done
    OMP_NUM_THREADS=1 python -m benchmarks.size.size --runs runs/exact/*

Runs are trained without rounding, loaded from their checkpoints, rounded here as training would
have (the same bytes), and both are measured on the held-out views at the run's scale.
"""

import lzma
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from benchmarks.bench import RESULTS, figure_at, machine, put, short_commit, write_rows
from gsynopsis.config import Joint, preset_of
from gsynopsis.container import decode, measure
from gsynopsis.container import encode_level as pieces_module
from gsynopsis.container import writer as writer_module
from gsynopsis.container.codecs import STRATEGIES, deflate
from gsynopsis.container.coding import PLANS, Coding, CodingPlan
from gsynopsis.container.rounding import rounded
from gsynopsis.container.writer import encode_with_account
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.train_run import make_context
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.records import LevelSet, Sensitivity
from gsynopsis.runs.folder import read_run, recorded_config
from gsynopsis.scene.load import load_scene
from gsynopsis.training.checkpoint import load_state
from gsynopsis.training.levels.sensitivity import sensitivity_of
from gsynopsis.training.loop import CHECKPOINT
from gsynopsis.training.state import TrainState

PAGE, CSV, CURVE = (RESULTS / name for name in ("size.md", "size.csv", "size.svg"))
CURVES, PARTS = RESULTS / "size_curves.csv", RESULTS / "size_parts.csv"
ORDERED, PLAN = "ordered, dB", "steps of the plan times"
FACTORS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
LOSSES = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        runs: Folders of finished runs, trained with `--set levels.coding_loss=0`.
        loss: Allowed loss of rounding, dB; that of the presets.
    """

    runs: tuple[Path, ...]
    loss: float = preset_of("standard").joint.coding_loss


@dataclass(frozen=True)
class Subject:
    """One run: its exact levels and how to see them."""

    name: str
    levels: LevelSet
    sensitivity: Sensitivity
    state: TrainState

    @cached_property
    def exact(self) -> list[float]:
        """PSNR of what training left."""
        return self.psnr(self.levels)

    def rounded(self, loss: float) -> LevelSet:
        """Level set as training leaves it with `levels.coding_loss`."""
        return rounded(self.levels, self.sensitivity, loss)

    def psnr(self, levels: LevelSet) -> list[float]:
        """Mean PSNR of 8-bit images over the held-out views for each level, dB."""
        model = model_from_levels(levels)
        context = self.state.context
        scene, scale = context.scene, context.config.scale
        black, means = torch.zeros(3), list[float]()
        for level in range(len(levels.levels)):
            values: list[float] = []
            for view in scene.test:
                camera = scene.camera(view, scale)
                with torch.no_grad():
                    drawn = model.decode(camera, level)
                    image = context.renderer.render(drawn, camera, black).image
                found = (image.clamp(0, 1) * 255).round()
                truth = torch.from_numpy(scene.image(view, scale).copy()).float()
                error = float(((found - truth) / 255).square().mean())
                values.append(-10 * float(np.log10(error)))
            means.append(float(np.mean(values)))
        return means


def load(run: Path) -> Subject:
    record, config = read_run(run), recorded_config(run)
    assert record.scene is not None
    context = make_context(load_scene(record.scene, config.split), config, RunOptions(device="cpu"))
    state = load_state(context, run / CHECKPOINT)
    if isinstance(config.levels, Joint) and config.levels.coding_loss:
        raise SystemExit(f"{run}: found rounded values, train with --set levels.coding_loss=0")
    levels = model_to_levels(state.model, {"scene": context.scene.name})
    return Subject(run.name, levels, sensitivity_of(state, levels), state)


def level_rows(subject: Subject, loss: float) -> list[dict[str, Any]]:
    """Sizes in all accountings and the loss of rounding and coding, one row a level.

    The paper's accountings are of what training left: rounded values would deflate better.
    """
    data, account = encode_with_account(subject.rounded(loss), "compact")
    coded = subject.psnr(decode(data, subject.name))
    rows: list[dict[str, Any]] = []
    for size, end, before, after in zip(
        measure(subject.levels), account.ends, subject.exact, coded, strict=True
    ):
        rows.append(
            {
                "run": subject.name,
                "level": size.level,
                "anchors": size.anchors,
                "slots": size.slots,
                "bytes_fp32": size.bytes_paper,
                "bytes_paper": size.bytes_deflate,
                "bytes_compact": end,
                "percent_of_paper": round(100 * end / size.bytes_deflate, 2),
                "psnr_exact": round(before, 3),
                "psnr_compact": round(after, 3),
                "loss_db": round(before - after, 3),
            }
        )
    return rows


def part_rows(subject: Subject, loss: float) -> list[dict[str, Any]]:
    """Bytes of each part of the compact file, beside the number of its values."""
    account = encode_with_account(subject.rounded(loss), "compact")[1]
    rows: list[dict[str, Any]] = []
    for kind in dict.fromkeys(part.kind for part in account.parts):
        own = [part for part in account.parts if part.kind == kind]
        stored, values = sum(p.stored for p in own), sum(p.values for p in own)
        rows.append(
            {
                "run": subject.name,
                "part": kind,
                "coding": own[0].coding or "-",
                "values": values,
                "bytes": stored,
                "bits_per_value": round(8 * stored / values, 2),
                "percent": round(100 * stored / account.total, 1),
            }
        )
    return rows


def part_table(rows: Sequence[dict[str, Any]]) -> str:
    """Bits per value and share of each part, a column for each run."""
    found = {(row["run"], row["part"]): row for row in rows}
    runs, parts = (list(dict.fromkeys(row[key] for row in rows)) for key in ("run", "part"))
    lines = [f"| part | {' | '.join(runs)} |", "|---" * (len(runs) + 1) + "|"]
    for part in parts:
        own = [found[run, part] for run in runs]
        cells = [f"{r['bits_per_value']:.2f}, {r['percent']:.1f} %" for r in own]
        lines.append(f"| {part} | {' | '.join(cells)} |")
    return "\n".join(lines)


def last_steps(levels: LevelSet) -> str:
    """Other last steps on the same raw bytes: what an entropy coder could win at most."""
    seen: list[tuple[bytes, list[int]]] = []

    def note(
        raw: bytes, sections: Sequence[int] = (), strategies: Sequence[int] = STRATEGIES
    ) -> tuple[bytes, list[int]]:
        seen.append((raw, list(sections) or [len(raw)]))
        return deflate(raw, sections, strategies)

    pieces_module.deflate = writer_module.deflate = note
    try:
        encode_with_account(levels, "compact")
    finally:
        pieces_module.deflate = writer_module.deflate = deflate
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME}]
    raws = [raw for raw, _ in seen if raw]
    ours = sum(len(deflate(raw, sections)[0]) for raw, sections in seen)
    best = sum(len(lzma.compress(raw, lzma.FORMAT_RAW, filters=filters)) for raw in raws)
    floor = sum(entropy(piece) for raw, sections in seen for piece in cut(raw, sections))
    rows = [
        ("raw bytes", sum(map(len, raws))),
        ("DEFLATE, a table per column (the file)", ours),
        ("order-0 entropy of each column (a perfect coder of single bytes)", round(floor)),
        ("LZMA2 with arithmetic coding (preset 9e)", best),
    ]
    return "; ".join(f"{name} {size:,} ({100 * size / ours - 100:+.1f} %)" for name, size in rows)


def cut(raw: bytes, sections: list[int]) -> list[bytes]:
    ends = np.cumsum(sections).tolist()
    return [raw[end - size : end] for end, size in zip(ends, sections, strict=True) if size]


def entropy(data: bytes) -> float:
    """Bytes that an ideal coder of independent bytes takes."""
    counts = np.bincount(np.frombuffer(data, np.uint8), minlength=256)
    share = counts[counts > 0] / len(data)
    return float(-(share * np.log2(share)).sum() * len(data) / 8)


Point = tuple[float, int, list[float]]
"""Loss or factor asked for, bytes of the file, PSNR of each level."""


def point(subject: Subject, ordered: float, levels: LevelSet, plan: Coding | CodingPlan) -> Point:
    data = encode_with_account(levels, plan)[0]
    return ordered, len(data), subject.psnr(decode(data, "x"))


def curve_of_steps(subject: Subject) -> list[Point]:
    """All steps of the plan times each factor."""
    plan, points = PLANS["compact"], list[Point]()
    for factor in FACTORS:
        coders = {f.name: getattr(plan, f.name) for f in fields(CodingPlan)}
        scaled = {k: c._replace(least=c.least * factor) for k, c in coders.items()}
        points.append(point(subject, factor, subject.levels, CodingPlan(**scaled)))
    return points


def curve_of_losses(subject: Subject) -> list[Point]:
    """Values rounded for each loss."""
    return [point(subject, loss, subject.rounded(loss), "compact") for loss in LOSSES]


def draw(curves: dict[str, list[Point]], exact: float, name: str) -> None:
    with figure_at(CURVE, 6, 3.6) as figure:
        axes = figure.add_subplot()
        for label, points in curves.items():
            axes.plot(
                [b / 2**20 for _, b, _ in points], [q[-1] for *_, q in points], "o-", label=label
            )
        axes.axhline(exact, linestyle="--", color="grey", label="float32")
        axes.set(xlabel="MiB of the whole file", ylabel="PSNR of the finest level, dB", title=name)
        axes.legend(loc="lower right")


@dataclass(frozen=True)
class Curve:
    """Points of one run by one way of rounding.

    Attributes:
        run: Its name.
        kind: `ordered, dB` or `steps of the plan times`.
        points: In the order of what was ordered.
        exact: PSNR of each level of what training left.
    """

    run: str
    kind: str
    points: list[Point]
    exact: list[float]

    def rows(self) -> list[dict[str, Any]]:
        """One row a point and level."""
        return [
            {
                "run": self.run,
                "kind": self.kind,
                "ordered": ordered,
                "bytes": size,
                "level": level,
                "loses_db": round(before - after, 3),
            }
            for ordered, size, found in self.points
            for level, (before, after) in enumerate(zip(self.exact, found, strict=True))
        ]


def table(rows: list[dict[str, Any]]) -> str:
    """A row for each run and level."""
    lines = [
        "| run | level | paper, MiB | compact, MiB | of paper | PSNR float32 | compact "
        "| loss, dB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        mib = " | ".join(f"{r[k] / 2**20:.3f}" for k in ("bytes_paper", "bytes_compact"))
        lines.append(
            f"| {r['run']} | L{r['level']} | {mib} | {r['percent_of_paper']:.1f} % | "
            f"{r['psnr_exact']:.2f} | {r['psnr_compact']:.2f} | {r['loss_db']:.3f} |"
        )
    return "\n".join(lines)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    subjects = [load(run) for run in options.runs]
    rows = [row for subject in subjects for row in level_rows(subject, options.loss)]
    write_rows(CSV, rows)
    first, curves = subjects[0], list[Curve]()
    for subject in subjects:
        own = (ORDERED, curve_of_losses(subject)), (PLAN, curve_of_steps(subject))
        curves += [Curve(subject.name, kind, points, subject.exact) for kind, points in own]
    draw({c.kind: c.points for c in curves[:2]}, first.exact[-1], first.name)
    points = [row for curve in curves for row in curve.rows()]
    write_rows(CURVES, points)
    seeds = sorted({s.state.context.config.train.seed for s in subjects})
    scales = sorted({s.state.context.config.scale for s in subjects})
    made = (
        f"Made on {machine().cpu}, commit {short_commit()}, seeds {seeds}, "
        f"scales {scales}, {options.loss:g} dB ordered."
    )
    steps = last_steps(first.rounded(options.loss))
    parts = [row for subject in subjects for row in part_rows(subject, options.loss)]
    write_rows(PARTS, parts)
    put(PAGE, __file__, page_text(rows, parts, steps, made))
    print(f"wrote {PAGE}, {CSV}, {PARTS}, {CURVES}, {CURVE}")


def page_text(
    rows: list[dict[str, Any]], parts: list[dict[str, Any]], steps: str, made: str
) -> str:
    """Two tables, the curve, other last steps, and how it was made."""
    return "\n\n".join(
        [
            table(rows),
            "![Bytes and quality of the finest level of the first run](size.svg)",
            "Bits per value and share of each part of the finest file:",
            part_table(parts),
            f"Other last steps of {rows[0]['run']}, bytes: {steps}.",
            made,
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
