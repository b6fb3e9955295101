"""Times the training step: ours, its control and plain PyTorch twins, part by part.

    python -m benchmarks.train.step --out step.json

Every contender trains until its anchors have grown and then takes turns with the others, because
timings of a shared machine are only good as ratios. The rasteriser of the twins is the native one.
"""

import copy
import json
import resource
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

import torch
import tyro

from benchmarks.bench import DATA, machine, put, short_commit
from gsynopsis._native import _core
from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.config import Config, Joint, ModelConfig, resolve_settings
from gsynopsis.model import anchors
from gsynopsis.model.build import CODEBOOK_DIM
from gsynopsis.model.decode import assemble_reference, heads_reference, visible_rows_reference
from gsynopsis.render import cpu
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.training import view_step
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import Phase
from gsynopsis.training.losses import photometric_reference, volume_reference
from gsynopsis.training.optim import adam as optimizer
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.phases.joint import JointPhase
from gsynopsis.training.state import TrainState, fresh_state, set_model, set_optimizer

PARTS = {
    "visible_rows": "culling",
    "fill_inputs": "gather",
    "hashgrid_forward": "grids",
    "choose": "codebook choice",
    "heads_forward": "heads",
    "count_drawn": "assembly",
    "assemble": "assembly",
    "photometric": "loss and its gradient",
    "mean_volume": "loss and its gradient",
    "assemble_backward": "assembly, backward",
    "heads_backward": "heads and codebook, backward",
    "scatter_rows": "heads and codebook, backward",
    "hashgrid_backward": "grids, backward",
    "adam": "Adam",
}
"""Native calls and the part of the step that each belongs to."""
OURS, TWIN = "ours, full", "ours, full, plain PyTorch"


@dataclass(frozen=True)
class Settings:
    """Options of the timing."""

    data: Path = DATA
    """Folder with the scene `fox`."""
    scale: float = 4.0
    grow: int = 600
    """Steps of each contender before timing; half of its schedule, when anchors stop to grow."""
    rounds: int = 40
    threads: int = 2
    plain: bool = True
    """Also time the plain PyTorch twins."""
    out: Path | None = None
    """Write the result as JSON."""
    page: Path | None = None
    """Write the tables between the marks of this page."""


@dataclass
class Timing:
    """Milliseconds of each round, counts of a view, and the time of each part."""

    anchors: int = 0
    visible: int = 0
    gaussians: int = 0
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    parts: dict[str, list[float]] = field(default_factory=dict)

    def add(self, step: Callable[[], None]) -> None:
        """Time one step."""
        busy, start = time.process_time(), time.perf_counter()
        step()
        self.wall.append(1e3 * (time.perf_counter() - start))
        self.cpu.append(1e3 * (time.process_time() - busy))


class OurSteps:
    """A training and the phase that it is in."""

    def __init__(self, state: TrainState, phase: Phase) -> None:
        self.state, self.phase = state, phase
        phase.begin(state)
        set_optimizer(state, phase.make_optimizer(state))

    def step(self) -> None:
        """One step, as `run_training` does it."""
        with one_torch_thread():
            self._step()

    def plain_step(self) -> None:
        """One step with everything but the rasteriser as plain PyTorch computes it."""
        with plain_twins():
            self._step()

    def _step(self) -> None:
        self.phase.step(self.state)
        self.state.progress.step += 1

    def count(self, timing: Timing) -> None:
        """Count the visible anchors and Gaussians of the finest level in one view."""
        model, context = self.state.model, self.state.context
        with torch.no_grad():
            camera = context.scene.camera(context.scene.train[0], context.config.scale)
            decoded = model.decode_part(model.part(-1), camera)
        timing.anchors, timing.visible = len(model), len(decoded.anchors)
        timing.gaussians = len(decoded.slots)


@contextmanager
def plain_twins() -> Iterator[None]:
    """Everything but the rasteriser as plain PyTorch computes it."""
    twins = {
        (anchors, "compute_heads"): heads_reference,
        (anchors, "assemble"): assemble_reference,
        (anchors, "native_rows"): visible_rows_reference,
        (view_step, "photometric_loss"): photometric_reference,
        (view_step, "volume_loss"): volume_reference,
        (optimizer, "_is_plain"): lambda _: False,
        (anchors.AnchorModel, "is_native"): lambda *_: False,
    }
    with ExitStack() as stack:
        for (owner, name), twin in twins.items():
            stack.enter_context(patch.object(owner, name, twin))
        yield


@contextmanager
def watched(parts: dict[str, float]) -> Iterator[None]:
    """Adds the milliseconds of native calls to the parts of the step."""

    def timed(function: Callable[..., object], part: str) -> Callable[..., object]:
        def call(*args: object, **options: object) -> object:
            start = time.perf_counter()
            try:
                return function(*args, **options)
            finally:
                parts[part] = parts.get(part, 0.0) + 1e3 * (time.perf_counter() - start)

        return call

    jobs = {"forward": "rasteriser", "backward": "rasteriser, backward"}
    with ExitStack() as stack:
        for name, part in PARTS.items():
            stack.enter_context(patch.object(_core, name, timed(getattr(_core, name), part)))
        for name, part in jobs.items():
            function = getattr(cpu._Job, name)
            stack.enter_context(patch.object(cpu._Job, name, timed(function, part)))
        yield


def configs(scale: float, grow: int) -> dict[str, Config]:
    """`ours` and its control with plain features, on a schedule that stops growth in time.

    The control has as many slots as Scaffold-GS.
    """
    ours = {"scale": scale, "train.steps": 2 * grow}
    free = {**ours, "model.feature": "free", "model.slots": ModelConfig.slots}
    asked = {"ours": ours, "free": free}
    return {name: resolve_settings("max", None, own).config for name, own in asked.items()}


def grown(scene: Scene, config: Config, grow: int) -> tuple[OurSteps, OurSteps]:
    """A full training whose anchors have grown, and the joint one that goes on from a copy."""
    steps, levels = config.train.steps, config.levels
    assert isinstance(levels, Joint)
    context = TrainContext(scene, config, cpu.CpuRenderer())
    full = OurSteps(fresh_state(context), FullPhase(steps, steps + levels.steps))
    for _ in range(grow):
        full.step()
    other = fresh_state(TrainContext(scene, config, cpu.CpuRenderer()))
    set_model(other, copy.deepcopy(full.state.model))
    return full, OurSteps(other, JointPhase(levels, steps))


def measure(settings: Settings) -> tuple[dict[str, Timing], "Limit"]:
    """All contenders in turn."""
    scene = load_scene(settings.data / "fox", "every8")
    contenders: dict[str, OurSteps] = {}
    for name, config in configs(settings.scale, settings.grow).items():
        pair = grown(scene, config, settings.grow)
        contenders |= {f"{name}, full": pair[0], f"{name}, joint": pair[1]}
    timings = {name: Timing() for name in contenders}
    for name, contender in contenders.items():
        contender.count(timings[name])
    steps = {name: contender.step for name, contender in contenders.items()}
    if settings.plain:
        timings[TWIN] = replace(timings[OURS], wall=[], cpu=[], parts={})
        steps[TWIN] = contenders[OURS].plain_step
    for step in steps.values():
        step()
    for _ in range(settings.rounds):
        for name, step in steps.items():
            timings[name].add(step)
    for name, contender in contenders.items():
        measure_parts(contender, timings[name], settings.rounds)
    return timings, limit_of(contenders[OURS], timings[OURS])


def measure_parts(contender: OurSteps, timing: Timing, rounds: int) -> None:
    """In steps of their own, because looking costs a little too."""
    for _ in range(rounds):
        parts: dict[str, float] = {}
        start = time.perf_counter()
        with watched(parts):
            contender.step()
        parts["everything else"] = 1e3 * (time.perf_counter() - start) - sum(parts.values())
        for part, ms in parts.items():
            timing.parts.setdefault(part, []).append(ms)


@dataclass(frozen=True)
class Limit:
    """Lower bound of a full step of `ours` on this machine, part by part."""

    multiply_adds: int
    """Multiply-adds of the heads and the codebook, forward and backward."""
    adam_bytes: int
    """Read and written by Adam."""
    pairs: int
    """Pairs of Gaussian and tile of one image."""
    gigaflops: float
    """Rate of a large matrix product on this machine, a multiply-add counting two."""
    gigabytes: float
    """Copied in a second here and now, read and written."""
    peak_mib: float
    """Most memory of this process so far, all contenders together."""

    @property
    def heads_ms(self) -> float:
        """The products of the heads at the speed of the large one."""
        return 2e-6 * self.multiply_adds / self.gigaflops

    @property
    def adam_ms(self) -> float:
        """Adam at the speed of a copy."""
        return 1e-6 * self.adam_bytes / self.gigabytes


def limit_of(contender: OurSteps, timing: Timing) -> Limit:
    """From counts of the model and the speed of the machine."""
    state, config = contender.state, contender.state.context.config.model
    renderer = state.context.renderer
    assert isinstance(renderer, cpu.CpuRenderer)
    hidden, outputs = 3 * config.hidden, 11 * config.slots
    inputs = 4 * config.grids + config.residual + 5
    row = CODEBOOK_DIM if config.codebook else 0
    forward = inputs * hidden + outputs * config.hidden
    backward = forward + outputs * config.hidden + (inputs - 5 + row) * hidden
    square, block = torch.randn(1024, 1024), torch.zeros(1 << 24)
    product = min(_seconds(lambda: square @ square) for _ in range(5))
    copied = min(_seconds(block.clone) for _ in range(5))
    return Limit(
        multiply_adds=timing.visible * (forward + backward + config.codebook * row),
        adam_bytes=28 * sum(p.numel() for p in state.optimizer.parameters()),
        pairs=renderer._free_frames[-1].pairs,
        gigaflops=2e-9 * 1024**3 / product,
        gigabytes=2e-9 * block.numel() * 4 / copied,
        peak_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def tables(timings: dict[str, Timing], limit: Limit) -> str:
    """Markdown: contenders, parts, limit."""
    lines = [
        "| step | anchors | in view | Gaussians | ms (median) | fastest | CPU ms | ratio |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    base = timings[OURS].wall
    for name, t in timings.items():
        ratio = statistics.median(a / b for a, b in zip(t.wall, base, strict=True))
        lines.append(
            f"| {name} | {t.anchors:,} | {t.visible:,} | {t.gaussians:,} "
            f"| {statistics.median(t.wall):.1f} | {min(t.wall):.1f} "
            f"| {statistics.median(t.cpu):.1f} | {ratio:.2f} |"
        )
    with_parts = [name for name, t in timings.items() if t.parts]
    lines += [
        "",
        f"| part, ms | {' | '.join(with_parts)} |",
        f"| ---{' | ---' * len(with_parts)} |",
    ]
    for part in timings[OURS].parts:
        cells = [f"{_median(timings[name].parts.get(part, [])):.2f}" for name in with_parts]
        lines.append(f"| {part} | {' | '.join(cells)} |")
    lines += [
        "",
        f"Limit of `{OURS}` on this machine: {limit.multiply_adds / 1e6:,.0f} million "
        f"multiply-adds in the heads are {limit.heads_ms:.1f} ms at the {limit.gigaflops:,.0f} "
        f"GFLOP/s of a large matrix product; Adam reads and writes "
        f"{limit.adam_bytes / 2**20:,.0f} MiB, {limit.adam_ms:.1f} ms at the "
        f"{limit.gigabytes:.0f} GB/s of a copy; the rasteriser blends {limit.pairs:,} pairs of "
        f"Gaussian and tile. Peak memory of all contenders together: {limit.peak_mib:,.0f} MiB.",
    ]
    return "\n".join(lines)


def _median(values: list[float]) -> float:
    return statistics.median(values) if values else 0.0


def main(settings: Settings) -> None:
    torch.set_num_threads(settings.threads)
    if not (settings.data / "fox").is_dir():
        raise SystemExit(f"--data: found no folder {settings.data / 'fox'}, expected the scene fox")
    timings, limit = measure(settings)
    facts = machine()
    text = (
        f"fox at 1/{settings.scale:g}, seed 0, after {settings.grow} steps; medians of "
        f"{settings.rounds} rounds; {facts.cpu}, {settings.threads} threads, commit "
        f"{short_commit()}.\n\n{tables(timings, limit)}"
    )
    print(text)
    if settings.page is not None:
        put(settings.page, __file__, text)
    if settings.out is not None:
        result = {
            "machine": asdict(facts),
            "commit": short_commit(),
            "settings": {k: str(v) for k, v in asdict(settings).items()},
            "timings": {name: asdict(t) for name, t in timings.items()},
            "limit": asdict(limit),
        }
        settings.out.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
        print(f"wrote {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
