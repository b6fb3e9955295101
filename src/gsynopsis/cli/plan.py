"""What `train` says before it starts, and what `--max-memory` does."""

import json
import math
import sys
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from gsynopsis.errors import SettingError, SpaceError
from gsynopsis.evaluate.phrases import count, memory
from gsynopsis.train.progress import Observer

if TYPE_CHECKING:
    from gsynopsis.train.plan import Plan
    from gsynopsis.train.trainer import Trainer

GIB = 2**30


def plan_training(trainer: "Trainer", max_memory: float | None) -> "Plan":
    """The plan of a fresh trainer; a limit in GiB becomes a limit of anchors in its settings.

    Raises:
        SettingError: the limit is no size.
        SpaceError: not even the anchors of the start fit the limit.
    """
    from gsynopsis.train.plan import make_plan, most_anchors, needed_bytes, peak_bytes

    scene, device, world = trainer.scene, trainer.renderer.device, trainer.world
    plan = make_plan(scene, trainer.config, device, world)
    if max_memory is None:
        return plan
    if not 0 < max_memory < math.inf:
        raise SettingError("--max-memory", found=max_memory, expected="GiB above 0")
    fitting = most_anchors(round(max_memory * GIB), scene, trainer.config, device)
    if fitting < plan.anchors:
        least = needed_bytes(scene, trainer.config, plan.anchors, device) / GIB
        raise SpaceError(
            "--max-memory",
            found=f"{max_memory:g} GiB",
            expected=f"at least {least + 0.005:.2f} GiB for the {plan.anchors:,} anchors to start",
            advice="allow more, or set model.voxel to a larger cell",
        )
    train = trainer.config.train
    most = min(train.growth.max_anchors, fitting)
    train = replace(train, growth=replace(train.growth, max_anchors=most))
    trainer.config = replace(trainer.config, train=train)
    most = max(plan.anchors, most)
    bounded = peak_bytes(scene, trainer.config, most, device)
    return replace(plan, max_anchors=most, most_bytes=bounded)


def plan_lines(plan: "Plan", steps: str = "") -> list[str]:
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


def tell_plan(
    plan: "Plan", display: Observer, steps: str = "", *, as_json: bool, quiet: bool
) -> None:
    """Say it: lines on the display, `steps` as in `plan_lines`, or one JSON object on stderr."""
    if as_json and not quiet:
        print(json.dumps({"event": "plan", **asdict(plan)}), file=sys.stderr, flush=True)
        return
    for line in plan_lines(plan, steps):
        display.on_message(line)
