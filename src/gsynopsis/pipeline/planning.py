"""What a training says before it starts, and how a limit of memory bounds its growth."""

import math
from dataclasses import replace

from gsynopsis.errors import SettingError, SpaceError
from gsynopsis.evaluation.phrases import count, memory
from gsynopsis.training.plan import TrainPlan, make_plan, most_anchors, needed_bytes
from gsynopsis.training.state import Setup

GIB = 2**30
PHOTO_SHARE = 1 / 8
"""Of a limit of memory: decoded photos that take more are kept in files."""


def plan_of(setup: Setup) -> TrainPlan:
    """What the training takes: photos, steps, anchors, memory. Nothing is decoded."""
    return make_plan(setup.scene, setup.config, setup.renderer.device, setup.world)


def bounded_setup(setup: Setup, max_memory: float | None) -> Setup:
    """The same training with growth that fits a limit of memory, GiB; None: no limit.

    Raises:
        SettingError: the limit is no size.
        SpaceError: not even the anchors of the start fit the limit.
    """
    if max_memory is None:
        return setup
    if not 0 < max_memory < math.inf:
        raise SettingError("--max-memory", found=max_memory, expected="GiB above 0")
    scene, config, device = setup.scene, setup.config, setup.renderer.device
    scene.cache.budget = min(scene.cache.budget, round(PHOTO_SHARE * max_memory * GIB))
    fitting = most_anchors(round(max_memory * GIB), scene, config, device)
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
            f"--max-memory {int(fair * 8) / 10:g} would stop growth in time"
        )
    return lines
