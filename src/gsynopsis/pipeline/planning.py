"""What a training says before it starts, and how a limit of memory bounds its growth."""

from dataclasses import replace

from gsynopsis.errors import SpaceError
from gsynopsis.evaluation.phrases import count, memory
from gsynopsis.pipeline.spilling import GIB, limit_bytes, spills
from gsynopsis.training.plan import (
    PROCESS_BYTES,
    TrainPlan,
    make_plan,
    most_anchors,
    needed_bytes,
)
from gsynopsis.training.state import Setup

PHOTO_SHARE = 1 / 8
"""Of a limit of memory: decoded photos that take more are kept in files."""


def plan_of(setup: Setup) -> TrainPlan:
    """What the training takes: photos, steps, anchors, memory. Nothing is decoded."""
    return make_plan(setup.scene, setup.config, setup.renderer.device, setup.world)


def bounded_setup(setup: Setup, max_memory: float | None) -> Setup:
    """The same training under a limit of memory, GiB; None: no limit.

    Where memory spills nothing of it changes but the photos kept in memory, and anchors out of view
    are left alone if all were too many. Elsewhere growth is bounded so that it fits.

    Raises:
        SettingError: the limit is no size.
        SpaceError: it is below what a process takes before it loads anything, or, where memory does
            not spill, not even the anchors of the start fit.
    """
    if max_memory is None:
        return setup
    limit = limit_bytes(max_memory)
    scene, config, device = setup.scene, setup.config, setup.renderer.device
    scene.cache.budget = min(scene.cache.budget, round(PHOTO_SHARE * limit))
    if spills(device):
        return _spilled_setup(setup, limit)
    fitting = most_anchors(limit, scene, config, device)
    anchors = plan_of(setup).anchors
    if fitting < anchors:
        least = needed_bytes(scene, config, anchors, device) / GIB
        raise SpaceError(
            "--max-memory",
            found=f"{max_memory:g} GiB",
            expected=f"at least {least + 0.005:.2f} GiB for the {anchors:,} anchors to start",
            advice="allow more, or set model.voxel to a larger cell",
        )
    growth = config.train.growth
    growth = replace(growth, max_anchors=min(growth.max_anchors, fitting))
    train = replace(config.train, growth=growth)
    return replace(setup, config=replace(config, train=train))


def _spilled_setup(setup: Setup, limit: int) -> Setup:
    if limit < PROCESS_BYTES:
        raise SpaceError(
            "--max-memory",
            found=f"{limit / GIB:g} GiB",
            expected=f"at least {PROCESS_BYTES / GIB + 0.005:.2f} GiB for a process by itself",
        )
    if setup.lazy is None and plan_of(setup).most_bytes > limit:
        return replace(setup, lazy=True)
    return setup


def plan_lines(plan: TrainPlan, steps: str = "", limit: int | None = None) -> list[str]:
    """The plan as people read it, and a warning if the machine may be too small.

    Args:
        plan: What training takes.
        steps: The steps of each phase in words; empty for their sum.
        limit: Bytes that a process has in memory at most, where the rest spills to disk.
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
    if limit is not None and plan.most_bytes > limit:
        lines.append(f"plan: {memory(limit)} of it in memory{each}, the rest on the run's disk")
    if plan.free_bytes is None:
        return lines
    if limit is not None:
        if plan.processes * min(plan.most_bytes, limit) > plan.free_bytes:
            free = memory(plan.free_bytes)
            lines.append(f"note: {free} are free, less than --max-memory allows; use a smaller one")
    elif plan.processes * plan.start_bytes > plan.free_bytes:
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
