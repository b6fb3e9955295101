"""The figures of docs/size.md: what a file takes by part and coding, and what coding costs in dB.

    OMP_NUM_THREADS=1 python benchmarks/size.py --runs runs/scenes/fox-fast runs/scenes/bonsai-fast

Each run is loaded from its checkpoint, packed without loss and compactly, and both are measured on
the held-out views at the run's scale. The curve scales all steps of the first run's coding.
"""

import csv
import lzma
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from gsynopsis.cli.run_folder import read_record
from gsynopsis.cli.training import new_trainer, recorded_config
from gsynopsis.evaluate.machine import this_machine
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.pack import decode, measure
from gsynopsis.pack import pieces as pieces_module
from gsynopsis.pack import writer as writer_module
from gsynopsis.pack.codecs import STRATEGIES, deflate
from gsynopsis.pack.plan import PLANS, CodingPlan
from gsynopsis.pack.writer import encode_with_account
from gsynopsis.records import LevelSet
from gsynopsis.train.checkpoint import load_checkpoint
from gsynopsis.train.run import CHECKPOINT
from gsynopsis.train.trainer import Trainer
from marked_pages import put, short_commit

ROOT = Path(__file__).parent.parent
PAGE, CSV, CURVE = (ROOT / "docs" / name for name in ("size.md", "size.csv", "size.svg"))
FACTORS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)


@dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        runs: Folders of finished runs.
    """

    runs: tuple[Path, ...]


@dataclass(frozen=True)
class Subject:
    """One run: its exact levels and how to see them."""

    name: str
    levels: LevelSet
    trainer: Trainer

    def psnr(self, levels: LevelSet) -> list[float]:
        """Mean PSNR of 8-bit pictures over the held-out views for each level, dB."""
        model = model_from_levels(levels)
        scene, scale = self.trainer.scene, self.trainer.config.scale
        black, means = torch.zeros(3), list[float]()
        for level in range(len(levels.levels)):
            values: list[float] = []
            for view in scene.test:
                camera = scene.camera(view, scale)
                with torch.no_grad():
                    drawn = model.decode(camera, level)
                    image = self.trainer.renderer.render(drawn, camera, black).image
                found = (image.clamp(0, 1) * 255).round()
                truth = torch.from_numpy(scene.image(view, scale).copy()).float()
                error = float(((found - truth) / 255).square().mean())
                values.append(-10 * float(np.log10(error)))
            means.append(float(np.mean(values)))
        return means


def load(run: Path) -> Subject:
    record, config = read_record(run), recorded_config(read_record(run))
    assert record.scene is not None
    trainer = new_trainer(record.scene, config, "cpu")
    load_checkpoint(trainer, run / CHECKPOINT)
    assert trainer.model is not None
    return Subject(run.name, model_to_levels(trainer.model, {"scene": trainer.scene.name}), trainer)


def level_rows(subject: Subject) -> list[dict[str, Any]]:
    """Sizes in all accountings and the loss of the compact coding, one row a level."""
    data, _ = encode_with_account(subject.levels, "compact")
    exact, coded = subject.psnr(subject.levels), subject.psnr(decode(data, subject.name))
    rows: list[dict[str, Any]] = []
    for size, before, after in zip(measure(subject.levels), exact, coded, strict=True):
        rows.append(
            {
                "run": subject.name,
                "level": size.level,
                "anchors": size.anchors,
                "slots": size.slots,
                "bytes_fp32": size.bytes_paper,
                "bytes_paper": size.bytes_deflate,
                "bytes_compact": size.bytes_compact,
                "percent_of_paper": round(100 * size.bytes_compact / size.bytes_deflate, 2),
                "psnr_exact": round(before, 3),
                "psnr_compact": round(after, 3),
                "loss_db": round(before - after, 3),
            }
        )
    return rows


def part_table(subject: Subject) -> str:
    """Bytes of each part of the compact file, beside float32 of the same values."""
    account = encode_with_account(subject.levels, "compact")[1]
    lines = [
        "| part | coding | values | bytes | bits per value | share |",
        "|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(part.kind for part in account.parts):
        own = [part for part in account.parts if part.kind == kind]
        stored, values = sum(p.stored for p in own), sum(p.values for p in own)
        coding = own[0].coding or "-"
        bits, share = 8 * stored / values, 100 * stored / account.total
        lines.append(
            f"| {kind} | {coding} | {values:,} | {stored:,} | {bits:.2f} | {share:.1f} % |"
        )
    return "\n".join(lines)


def coder_table(subject: Subject) -> str:
    """Other last steps on the same raw bytes: what an entropy coder could win at most."""
    seen: list[tuple[bytes, list[int]]] = []

    def note(
        raw: bytes, sections: Sequence[int] = (), strategies: Sequence[int] = STRATEGIES
    ) -> tuple[bytes, list[int]]:
        seen.append((raw, list(sections) or [len(raw)]))
        return deflate(raw, sections, strategies)

    pieces_module.deflate = writer_module.deflate = note
    try:
        encode_with_account(subject.levels, "compact")
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
    lines = ["| last step | bytes | to the file |", "|---|---|---|"]
    lines += [f"| {name} | {size:,} | {100 * size / ours - 100:+.1f} % |" for name, size in rows]
    return "\n".join(lines)


def cut(raw: bytes, sections: list[int]) -> list[bytes]:
    ends = np.cumsum(sections).tolist()
    return [raw[end - size : end] for end, size in zip(ends, sections, strict=True) if size]


def entropy(data: bytes) -> float:
    """Bytes that an ideal coder of independent bytes takes."""
    counts = np.bincount(np.frombuffer(data, np.uint8), minlength=256)
    share = counts[counts > 0] / len(data)
    return float(-(share * np.log2(share)).sum() * len(data) / 8)


def curve(subject: Subject) -> list[tuple[float, int, float]]:
    """Factor on all steps, bytes of the file, PSNR of the finest level."""
    points: list[tuple[float, int, float]] = []
    for factor in FACTORS:
        plan = PLANS["compact"]
        coders = {f.name: getattr(plan, f.name) for f in fields(CodingPlan)}
        scaled = {k: c._replace(least=c.least * factor) for k, c in coders.items()}
        data = encode_with_account(subject.levels, CodingPlan(**scaled))[0]
        points.append((factor, len(data), subject.psnr(decode(data, "x"))[-1]))
    return points


def draw(points: list[tuple[float, int, float]], exact: float, name: str) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "size", "svg.fonttype": "none"}):
        figure = Figure(figsize=(6, 3.6), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(
            [b / 2**20 for _, b, _ in points], [q for _, _, q in points], "o-", label="compact"
        )
        axes.axhline(exact, linestyle="--", color="grey", label="float32")
        axes.set(xlabel="MiB of the whole file", ylabel="PSNR of the finest level, dB", title=name)
        axes.legend(loc="lower right")
        figure.savefig(CURVE, metadata={"Date": None})


def table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| run | level | anchors | slots | fp32 MiB | paper MiB | compact MiB | of paper | PSNR "
        "float32 | PSNR compact | loss dB |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        mib = " | ".join(
            f"{r[k] / 2**20:.3f}" for k in ("bytes_fp32", "bytes_paper", "bytes_compact")
        )
        lines.append(
            f"| {r['run']} | L{r['level']} | {r['anchors']:,} | {r['slots']:,} | {mib} | "
            f"{r['percent_of_paper']:.1f} % | {r['psnr_exact']:.2f} | {r['psnr_compact']:.2f} | "
            f"{r['loss_db']:.3f} |"
        )
    return "\n".join(lines)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    subjects = [load(run) for run in options.runs]
    rows = [row for subject in subjects for row in level_rows(subject)]
    with CSV.open("w", newline="") as handle:
        writer = csv.DictWriter(handle, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    first = subjects[0]
    points = curve(first)
    draw(points, first.psnr(first.levels)[-1], first.name)
    seeds = sorted({s.trainer.config.train.seed for s in subjects})
    scales = sorted({s.trainer.config.scale for s in subjects})
    machine = this_machine(torch.device("cpu")).cpu
    steps = ["| steps times | bytes | PSNR of the finest level |", "|---|---|---|"]
    steps += [f"| {f:g} | {b:,} | {q:.3f} |" for f, b, q in points]
    text = [
        f"Made on {machine}, commit {short_commit()}, seeds {seeds}, scales {scales}.",
        "",
        table(rows),
        *(f"\n### Parts of {s.name}\n\n{part_table(s)}" for s in subjects),
        f"\n### Other last steps, {first.name}\n\n{coder_table(first)}",
        f"\n### Rate and distortion, {first.name}\n\n![curve](size.svg)\n",
        *steps,
    ]
    put(PAGE, "size.py", "\n".join(text))
    print(f"wrote {PAGE}, {CSV}, {CURVE}")


if __name__ == "__main__":
    sys.exit(main())
