"""A whole training step by WGSL kernels: lines, kernels, bytes that cross, memory, time by part.

    LP_NUM_THREADS=2 python -m benchmarks.gpu.webgpu --page docs/scale.md

Steps of our model as it begins, on a made-up cloud that every camera sees whole, beside the
same steps on the CPU. On a software driver times say nothing of a card; only their ratios to each
other do, a little. What a card would take is worked out on paper: bytes of all buffers that a
step's kernels are given, once each, at 30 % of a card's bandwidth.
"""

import re
import statistics
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro

from benchmarks.bench import RESULTS, ROOT, Row, put, short_commit, table_of, write_rows
from benchmarks.train.large_steps import cloud
from gsynopsis.config import Config, resolve_settings
from gsynopsis.render.base import Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.webgpu.device import Gpu
from gsynopsis.render.webgpu.kernels import FOLDER, kernel_files
from gsynopsis.render.webgpu.renderer import WebGpuRenderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.state import TrainState, fresh_state, set_optimizer

CSV = RESULTS / "webgpu.csv"
SIZES = ((1_000, 240, 160), (6_000, 480, 320))
"""Points of the clouds, and pixels across and down."""
PARTS = {
    "culling, heads, assembly": "cull compact head_inputs grid_inputs choose_code linear "
    "mark_drawn assemble drop_out",
    "rasterizer": "project gather_counts list_pairs radix_count radix_scatter tile_starts blend",
    "loss": "loss_rows loss_columns slope_rows loss_gradient slot_sums log_loss "
    "exposure_sums expose expose_backward",
    "rasterizer, backward": "blend_backward project_backward",
    "heads, assembly, backward": "assemble_backward linear_back outer_sums add_parts "
    "add_rows codebook_sums logits_backward grid_backward drop_out_backward",
    "growth statistics": "count_view",
    "Adam": "adam average",
    "prefix sums of all parts": "scan scan_add",
}
CARDS = {"Radeon RX 6600": 224, "GeForce RTX 3060": 360, "Apple M1": 68}
"""Bandwidth, 10⁹ bytes a second, as makers state it."""
SHARE = 0.3
MIB = 2**20


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        adapter: Part of the adapter's name; empty: the first.
        rounds: Steps of each row.
        page: Write the CSV, and a table between the marks of this page.
    """

    adapter: str = ""
    rounds: int = 3
    page: Path | None = None


def lines_of(paths: list[Path]) -> int:
    """Lines that are neither empty nor comments."""
    texts = (path.read_text("utf-8").splitlines() for path in paths)
    return sum(bool(re.match(r"\s*[^\s/#]", line)) for text in texts for line in text)


def state_of(
    config: Config, renderer: Renderer, points: int, width: int, height: int
) -> TrainState:
    """A full training before its first step, whose views are counted for growth."""
    state = fresh_state(TrainContext(cloud(points, width, height), config, renderer))
    phase = FullPhase(config.train.steps, config.train.steps)
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    state.progress.step = config.train.steps // 10
    return state


@contextmanager
def timed_kernels(gpu: Gpu, spent: dict[str, float], moved: Counter[str]) -> Iterator[None]:
    """Milliseconds of each kernel, the device awaited after each, and bytes of its buffers."""
    probe, run = gpu.empty(1), gpu.run_grid

    def timed(name: str, groups: tuple[int, int], buffers: Any, /, **values: float) -> None:
        gpu.read(probe, "u4", 1)
        start = time.perf_counter()
        run(name, groups, buffers, **values)
        gpu.read(probe, "u4", 1)
        spent[name] += 1e3 * (time.perf_counter() - start)
        moved[name] += sum(buffer.size for buffer in buffers)

    gpu.run_grid = timed  # type: ignore[method-assign]
    try:
        yield
    finally:
        del gpu.run_grid


def measure(options: Options, points: int, width: int, height: int) -> Row:
    """One size: a step on the device and on the CPU."""
    config = resolve_settings("max", None, {"train.growth.every": 10_000}).config
    phase = FullPhase(config.train.steps, config.train.steps)
    renderer = WebGpuRenderer(options.adapter)
    gpu, state = renderer.gpu, state_of(config, renderer, points, width, height)
    for _ in state.context.scene.train:  # compiles, and uploads every photo
        phase.step(state)
    before, walls = dict(gpu.counts), list[float]()
    for _ in range(options.rounds):
        walls.append(_milliseconds(lambda: _awaited(phase, state, gpu)))
    counts = {k: (v - before[k]) / options.rounds for k, v in gpu.counts.items()}
    counts["reads"] -= 1  # the clock's own
    spent, moved = defaultdict[str, float](float), Counter[str]()
    with timed_kernels(gpu, spent, moved):
        phase.step(state)
    parts = {p: sum(spent[name] for name in names.split()) for p, names in PARTS.items()}
    assert set(spent) <= set(" ".join(PARTS.values()).split())
    resident = sum(buffer.size for _, buffer in state.whole.held._held.values())  # type: ignore[union-attr]
    scratch = sum(size * len(held) for size, held in gpu._waiting.items())
    grads = sum(buffer.size for buffer in state.whole.held._grads.values())  # type: ignore[union-attr]

    twin = state_of(config, CpuRenderer(), points, width, height)
    phase.step(twin)
    cpu = statistics.median(
        _milliseconds(lambda: phase.step(twin)) for _ in range(max(3, options.rounds))
    )
    bandwidth = sum(moved.values())
    return {
        "adapter": gpu.adapter.name,
        "software": int(gpu.adapter.software),
        "width": width,
        "height": height,
        "anchors": len(state.model),
        "dispatches": round(counts["dispatches"]),
        "reads": round(counts["reads"]),
        "up_bytes": round(counts["up"]),
        "down_bytes": round(counts["down"]) - 4,
        "resident_mib": round((resident + grads) / MIB, 1),
        "scratch_mib": round(scratch / MIB, 1),
        "ms": round(statistics.median(walls)),
        "cpu_ms": round(cpu, 1),
        **{f"{p.replace(',', '').replace(' ', '_')}_ms": round(ms, 1) for p, ms in parts.items()},
        "buffers_mib": round(bandwidth / MIB, 1),
        **{
            f"paper_{card.replace(' ', '_')}_ms": round(1e3 * bandwidth / (SHARE * speed * 1e9), 2)
            for card, speed in CARDS.items()
        },
        "commit": short_commit(),
    }


def anchor_bytes(config: Config) -> int:
    """Bytes that an anchor takes on the device between steps.

    Values, gradients, two moments, averages; growth statistics, its place and its mask.
    """
    slots, residual = config.model.slots, config.model.residual
    values = 3 * slots + 6 + residual
    return 4 * (5 * values + 2 * slots + 2 + 3 + 1)


def _awaited(phase: FullPhase, state: TrainState, gpu: Gpu) -> None:
    phase.step(state)
    gpu.read(state.whole._log, "u4", 1)  # type: ignore[union-attr]


def _milliseconds(work: Any) -> float:
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)


def text_of(rows: list[Row]) -> str:
    """A table of the sizes, and what follows from them."""
    kernels = list(kernel_files().values())
    shared, source = list((FOLDER / "parts").glob("*.wgsl")), ROOT / "src" / "gsynopsis"
    python = [p for room in ("render", "training") for p in (source / room / "webgpu").glob("*.py")]
    each = anchor_bytes(resolve_settings("max", None, {}).config)
    heads = ["", *(f"{r['width']} × {r['height']}, {r['anchors']:,} anchors" for r in rows)]
    wanted = {
        "dispatches of a step": "dispatches",
        "reads that wait for the device": "reads",
        "bytes to the device": "up_bytes",
        "bytes from the device": "down_bytes",
        "MiB between steps": "resident_mib",
        "MiB of a step's own buffers": "scratch_mib",
    }
    table = [[name, *(f"{r[key]:,}" for r in rows)] for name, key in wanted.items()]
    table.append(["times the CPU's step", *(f"{r['ms'] / r['cpu_ms']:.0f}" for r in rows)])
    for card in CARDS:
        key = f"paper_{card.replace(' ', '_')}_ms"
        table.append([f"on paper: ms on {card}", *(f"{r[key]:g}" for r in rows)])
    kind = "a software driver; not run on a GPU" if rows[0]["software"] else "a GPU"
    return "\n\n".join(
        [
            f"{len(kernels)} kernels, {lines_of(kernels + shared):,} lines of WGSL and "
            f"{lines_of(python):,} of Python ({rows[0]['adapter']}, {kind}):",
            table_of(heads, table),
            f"An anchor of our model takes {each:,} bytes on the device between steps: "
            f"{each * 1e5 / MIB:,.0f} MiB for 100,000 anchors, {each * 1e6 / MIB:,.0f} MiB for a "
            "million. The times on paper are the bytes of all buffers that a step's kernels are "
            f"given at {SHARE:.0%} of a card's stated bandwidth; no card was measured.",
        ]
    )


def main(options: Options) -> None:
    """Measure, print, and write if a page is given."""
    torch.set_num_threads(2)
    rows = [measure(options, *size) for size in SIZES]
    print(text_of(rows))
    if options.page:
        write_rows(CSV, rows)
        put(options.page, __file__, text_of(rows))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
