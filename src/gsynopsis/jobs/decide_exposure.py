"""The decision whether a training solves each photo's exposure, where that is left to the photos.

Off unless proven. Observations of the same points have to say that photos differ and that views
nearby do not tell how, and then a fork has to show that held-back photos gain by it.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from gsynopsis.config import Recipe, replaced
from gsynopsis.runs.folder import RUN_FILE, read_record, recorded_config
from gsynopsis.scene.exposure import exposure_evidence
from gsynopsis.training.context import TrainContext
from gsynopsis.training.fork import fork_exposure
from gsynopsis.training.loop import CHECKPOINT
from gsynopsis.training.observer import Observer

NAME = "train.exposure"
LEAST_GAIN = 0.1
"""Decibels on held-back photos from which exposure is solved, if that is no accident of few."""
Decision = tuple[Literal["on", "off"], str]
"""The value, and why."""


def with_exposure(
    context: TrainContext, recipe: Recipe, out: Path, observer: Observer, stop: Callable[[], bool]
) -> tuple[TrainContext, Recipe]:
    """Training and recipe with exposure on or off; as they are unless it is `auto`.

    A run goes on as it was begun.

    Args:
        context: Of the training.
        recipe: Where its settings come from.
        out: Folder of the run.
        observer: Told of the decision.
        stop: Asked after each step of the fork.

    Raises:
        KeyboardInterrupt: `stop` said so.
    """
    if context.config.train.exposure != "auto":
        return context, recipe
    decision = _begun_so(out) or decide_exposure(context, observer, stop)
    note = f"{NAME} {decision[0]}: {decision[1]}"
    observer.on_message(f"settings: {note}")
    scene = replace(context.scene, notes=(*context.scene.notes, note))  # for the report
    config = replaced(context.config, {NAME: decision[0]})
    return replace(context, scene=scene, config=config), _decided(recipe, decision)


def begun_recipe(recipe: Recipe, out: Path) -> Recipe:
    """The recipe with exposure as the run in `out` decided, if that was left to it."""
    decision = _begun_so(out) if recipe.config.train.exposure == "auto" else None
    return recipe if decision is None else _decided(recipe, decision)


def _decided(recipe: Recipe, decision: Decision) -> Recipe:
    value, reason = decision
    followed = {**recipe.followed, NAME: reason}
    return replace(recipe, config=replaced(recipe.config, {NAME: value}), followed=followed)


def _begun_so(out: Path) -> Decision | None:
    if not ((out / CHECKPOINT).exists() and (out / RUN_FILE).exists()):
        return None
    value, record = recorded_config(out).train.exposure, read_record(out)
    return None if value == "auto" else (value, record.followed.get(NAME, "as the run was begun"))


def decide_exposure(
    context: TrainContext, observer: Observer, stop: Callable[[], bool]
) -> Decision:
    """Decision whether exposure is solved, and the reason with its figures.

    Raises:
        KeyboardInterrupt: `stop` said so.
    """
    if context.config.train.batch > 1:
        return "off", "it is solved from one view per step"
    evidence = exposure_evidence(context.scene)
    differ = f"photos differ by {evidence.spread:.0%} in brightness or white balance"
    if not evidence.sufficient:
        return "off", evidence.rejection
    fork = fork_exposure(context, observer, stop)
    if fork is None:
        return "off", f"{differ}, too few photos or steps to try whether it helps"
    shown = f"held-back photos {sum(fork.on) / len(fork.on):.2f} dB with it"
    reason = f"{differ}; {shown}, {sum(fork.off) / len(fork.off):.2f} without"
    return ("on" if fork.gain >= max(LEAST_GAIN, fork.doubt) else "off"), reason
