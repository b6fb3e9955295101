"""Time left in a training, from the steps so far and the cost of those to come."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

from gsynopsis.config import Config, Joint, level_scale
from gsynopsis.evaluation.formatting import duration
from gsynopsis.training.loop import phases_of
from gsynopsis.training.observer import StepInfo

FIRST_STEPS = 5
"""Steps of a phase that are not timed: memory is new, photos are read."""
TIMED_STEPS = 25
"""Steps of a phase after which something is said."""
KEEP = 0.98
"""Weight of the past in the pace, about 50 steps."""
WORTH_SECONDS = 60.0
"""Least time left that is worth a line; the bar says enough of shorter trainings."""
GROWTH, GROWTH_STEPS = 0.9, 1_500
"""Growth makes a step dearer by this share in so many steps of full training, at most twice as dear
(fox and the demo scene; more is seen when it comes)."""
REST = 250_000
"""Pixels that take as long as a first step's work on anchors (two scenes, three sizes)."""


@dataclass(frozen=True)
class PhaseCost:
    """A phase, and what its steps cost in first steps of the full training.

    Attributes:
        name: As observers hear it.
        steps: How many.
        start: Cost of its first step.
        end: Cost from `grown` on; in between it rises evenly.
        grown: Share of the phase's steps after which nothing grows any more.
        small: Steps until which photos are smaller, and the share that a step takes with them.
    """

    name: str
    steps: int
    start: float
    end: float
    grown: float = 1.0
    small: tuple[tuple[float, float], ...] = ()

    def at(self, step: float) -> float:
        """Cost of a step."""
        share = next((share for until, share in self.small if step < until), 1.0)
        return share * self._whole(step)

    def after(self, step: float) -> float:
        """Cost of all steps after so many of them."""
        total, begin = 0.0, step
        for until, share in (*self.small, (float(self.steps), 1.0)):
            end = min(max(until, begin), self.steps)
            total += share * (self._whole_after(begin) - self._whole_after(end))
            begin = end
        return total

    def _whole(self, step: float) -> float:
        """Cost of a step with whole photos."""
        rising = self.grown * self.steps
        return self.start + (self.end - self.start) * (step / rising if step < rising else 1.0)

    def _whole_after(self, step: float) -> float:
        rising = max(0.0, self.grown * self.steps - step)
        flat = self.steps - step - rising
        return rising * (self._whole(step) + self.end) / 2 + flat * self.end


def phase_costs(config: Config, pixels: float) -> list[PhaseCost]:
    """The phases of a training, in order, by what is known before it starts.

    Args:
        config: Its settings.
        pixels: Pixels of a picture.
    """
    own = pixels / (pixels + REST)  # share of a step that a level takes without any anchor
    levels, growth = config.levels, config.train.growth
    grown = 1.0 + min(1.0, GROWTH * config.train.steps / GROWTH_STEPS)
    shares = list(accumulate(levels.keep, lambda a, b: a * b, initial=1.0))[::-1]
    level_costs = [own + (1 - own) * share for share in shares]
    found: list[PhaseCost] = []
    for phase in phases_of(config):
        if phase.name == "full":
            small = small_photos(config, 0, own)
            found.append(PhaseCost("full", phase.steps, 1.0, grown, growth.until, small))
        elif isinstance(levels, Joint):
            each = grown * joint_cost(levels, level_costs)
            small = small_photos(config, config.train.steps, own)
            found.append(PhaseCost(phase.name, phase.steps, each, each, small=small))
        else:
            number = int(phase.name.removeprefix("unfold L"))
            fewer = (config.scale / level_scale(config, number)) ** 2
            each = grown * (own * fewer + (1 - own) * shares[number])
            found.append(PhaseCost(phase.name, phase.steps, each, each))
    return found


def small_photos(config: Config, before: int, own: float) -> tuple[tuple[float, float], ...]:
    """`PhaseCost.small` of a phase that begins after so many steps, see `reduced_until`.

    Args:
        config: Settings of the training.
        before: Steps before the phase.
        own: Share of a step with whole photos that their pixels take.
    """
    every = config.train.steps + (config.levels.steps if isinstance(config.levels, Joint) else 0)
    untils = sorted(config.train.reduced_until)
    fewer = [4.0 ** -(len(untils) - place) for place in range(len(untils))]
    return tuple(
        (until * every - before, 1 - own + own * share)
        for until, share in zip(untils, fewer, strict=True)
        if until * every > before
    )


def joint_cost(levels: Joint, level_costs: Sequence[float]) -> float:
    """Cost of a step that renders several levels, relative to one that renders the finest alone."""
    count = len(level_costs)
    together = min(levels.levels_per_step, count)
    if count == 1:
        return level_costs[0]
    return level_costs[-1] + (together - 1) * sum(level_costs[:-1]) / (count - 1)


def steps_text(config: Config) -> str:
    """Steps of each phase as text: `300 steps full + 500 joint = 800`."""
    full, *others = phases_of(config)
    parts = [f"{full.steps:,} steps {full.name}"]
    parts += [f"{phase.steps:,} {phase.name}" for phase in others]
    return f"{' + '.join(parts)} = {sum(phase.steps for phase in (full, *others)):,}"


class TimeLeft:
    """Time until all phases of a training are done, from the pace of the steps so far."""

    def __init__(
        self, costs: Sequence[PhaseCost], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`costs` are those of all phases, in order."""
        self._costs, self._clock = costs, clock
        self._phase, self._seen, self._last = "", 0, 0.0
        self._seconds = self._work = 0.0

    def add(self, info: StepInfo) -> tuple[StepInfo, str]:
        """The step with the time left, and a line on that once a phase, else ""."""
        now = self._clock()
        if info.phase != self._phase:
            self._phase, self._seen = info.phase, 0
        self._seen += 1
        cost = next((cost for cost in self._costs if cost.name == info.phase), None)
        if cost is not None and self._seen > FIRST_STEPS:
            self._seconds = KEEP * self._seconds + now - self._last
            self._work = KEEP * self._work + cost.at(info.step)
        self._last = now
        left = self._left(info, cost) if cost is not None and self._work else None
        line = ""
        if left is not None and self._seen == FIRST_STEPS + TIMED_STEPS and left >= WORTH_SECONDS:
            line = f"plan: about {duration(left)} left for all steps to come"
        return replace(info, left=left), line

    def _left(self, info: StepInfo, cost: PhaseCost) -> float:
        later = self._costs[self._costs.index(cost) + 1 :]
        work = cost.after(info.step) + sum(phase.after(0) for phase in later)
        return work * self._seconds / self._work
