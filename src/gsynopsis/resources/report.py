"""Plan of a training before it starts, and growth bounded by a limit of memory."""

from dataclasses import replace

from gsynopsis.errors import SettingError, SpaceError
from gsynopsis.evaluation.formatting import count, memory
from gsynopsis.model.build import make_frame
from gsynopsis.resources.estimate import (
    DECODED_BYTES,
    TrainPlan,
    make_plan,
    most_anchors,
    needed_bytes,
)
from gsynopsis.scene.stored import AT_ONCE, DECODING
from gsynopsis.training.context import TrainContext

GIB = 2**30
MEMORY_MOST = 1_000_000
"""GiB: more than any machine has, and few enough to count in bytes."""
CELLS = tuple(1.25**power for power in range(1, 32))
"""Factors on the lattice cell that are tried for a start that does not fit."""
PHOTO_SHARE = 1 / 8
"""Share of a limit of memory beyond which decoded photos are kept in files."""


def plan_of(context: TrainContext) -> TrainPlan:
    """Plan of the training: photos, steps, anchors, memory. Nothing is decoded."""
    return make_plan(context.scene, context.config, context.renderer.device, context.group)


def bounded(context: TrainContext, max_memory: float | None) -> TrainContext:
    """The same training with growth that stops in time for a limit of memory.

    Args:
        context: The training.
        max_memory: GiB that each process may take, of the GPU if that is what trains; None: no
            limit.

    Raises:
        SettingError: the limit is no size.
        SpaceError: not even the anchors of the start fit.
    """
    scene, config, device = context.scene, context.config, context.renderer.device
    DECODING.allow(AT_ONCE)
    if max_memory is None:
        return context
    limit = limit_bytes(max_memory)
    if device.type == "cpu":  # one photo at least, whatever the limit: the plan counts it
        DECODING.allow(min(AT_ONCE, round(PHOTO_SHARE * limit) // DECODED_BYTES))
    scene.cache.budget = min(scene.cache.budget, round(PHOTO_SHARE * limit))
    fitting = most_anchors(limit, scene, config, device)
    anchors = plan_of(context).anchors
    if fitting < anchors:
        least = needed_bytes(scene, config, anchors, device) / GIB
        cell = _fitting_cell(context, fitting) if fitting else None
        other = "" if cell is None else f", or give --model.voxel {cell}: larger cells fit"
        raise SpaceError(
            "--max-memory",
            found=f"{max_memory:g} GiB",
            expected=f"at least {least + 0.005:.2f} GiB for the {anchors:,} anchors to start",
            advice=f"allow more{other}",
        )
    growth = config.train.growth
    growth = replace(growth, max_anchors=min(growth.max_anchors, fitting))
    train = replace(config.train, growth=growth)
    return replace(context, config=replace(config, train=train))


def limit_bytes(max_memory: float) -> int:
    """A limit of memory, GiB, in bytes.

    Raises:
        SettingError: it is no size.
    """
    if not 0 < max_memory <= MEMORY_MOST:
        expected = f"GiB above 0, at most {MEMORY_MOST:,}"
        raise SettingError("--max-memory", found=max_memory, expected=expected)
    return round(max_memory * GIB)


def _fitting_cell(context: TrainContext, most: int) -> str | None:
    """A lattice cell so large that at most `most` anchors start; None if none up to 1,000-fold."""
    scene, config = context.scene, context.config
    own = make_frame(scene, config.model).voxel
    for larger in CELLS:
        cell = f"{own * larger:.3g}"
        model = replace(config.model, voxel=float(cell))
        if plan_of(replace(context, config=replace(config, model=model))).anchors <= most:
            return cell
    return None


def plan_lines(plan: TrainPlan, steps: str = "") -> list[str]:
    """The plan as people read it, and a warning if the machine may be too small.

    Args:
        plan: What training takes.
        steps: The steps of each phase in words; empty for their sum.
    """
    views = f" of {plan.batch} views" if plan.batch > 1 else ""
    each = f" in each of {plan.processes} processes" if plan.processes > 1 else ""
    start, most = memory(plan.start_bytes), memory(plan.most_bytes)
    lines = [
        f"plan: {plan.photos} photos of {plan.width} × {plan.height}, "
        f"{steps or f'{plan.steps:,} steps'}{views}",
        f"plan: {count(plan.anchors)} anchors at the start, about {start} of memory{each}; "
        f"at most {count(plan.max_anchors)}, about {most}",
    ]
    if plan.beyond:
        lines.append(
            f"note: {plan.beyond:,} points lie too many cells from the origin and were left out; "
            "move the scene to the origin, or set model.voxel to a larger cell"
        )
    if plan.free_bytes is None:
        return lines
    if plan.processes * plan.start_bytes > plan.free_bytes:
        lines.append(
            f"note: {memory(plan.free_bytes)} are free, less than the start needs; "
            "use a larger --scale or free some memory"
        )
    elif plan.processes * plan.most_bytes > plan.free_bytes:
        fair = plan.free_bytes / plan.processes / GIB
        lines.append(
            f"note: {memory(plan.free_bytes)} are free, less than the most anchors would need; "
            f"--max-memory {int(fair * 8) / 10:g} would bound it"
        )
    return lines
