"""How long a training takes, told while it runs."""

import pytest

from gsynopsis.config import Config, Joint, resolve_settings, total_steps
from gsynopsis.monitor.eta import REST, PhaseCost, TimeLeft, joint_cost, phase_costs, steps_text
from gsynopsis.monitor.listeners import Listeners
from gsynopsis.training.observer import Silent, StepInfo

PIXELS = REST * 2 / 3
"""Pixels of a picture whose pixels take 0.4 of a first step."""


def with_steps(preset: str, steps: int) -> Config:
    return resolve_settings(preset, None, {"train.steps": steps}).config


class Heard(Silent):
    """Notes what comes."""

    def __init__(self) -> None:
        self.infos, self.texts = list[StepInfo](), list[str]()

    def on_step(self, info: StepInfo) -> None:
        self.infos.append(info)

    def on_message(self, text: str) -> None:
        self.texts.append(text)


def times(config: Config, growth: float) -> list[tuple[str, int, int, float]]:
    """Phase, step, steps and seconds of each step of a training like fox's: the levels draw three
    pictures a step, and growth makes each dearer, not as the plan thinks."""
    found: list[tuple[str, int, int, float]] = []
    for cost in phase_costs(config, PIXELS):
        for step in range(1, cost.steps + 1):
            grown = 1 + growth * min(1.0, step / (0.7 * cost.steps))
            each = 0.047 * (grown if cost.name == "full" else 2.4 * (1 + growth))
            found.append((cost.name, step, cost.steps, each))
    return found


@pytest.mark.parametrize("growth", [0.4, 0.9, 1.4])
@pytest.mark.parametrize("steps", [600, 1500])
def test_the_time_left_is_that_of_all_phases_with_their_own_costs(
    growth: float, steps: int
) -> None:
    config, now, heard = with_steps("standard", steps), 100.0, Heard()
    estimate = Listeners([heard], TimeLeft(phase_costs(config, PIXELS), lambda: now))
    plan = times(config, growth)
    truth = sum(seconds for *_, seconds in plan)
    actual: list[float] = []
    for phase, step, count, seconds in plan:
        now += seconds
        truth -= seconds
        actual.append(truth)
        estimate.on_step(StepInfo(phase, step, count, 0.1, 20.0, 100, 2**29))
    told = [info.left for info in heard.infos]
    assert told[:5] == [None] * 5
    for at in (30, steps // 2, steps - 1, steps + 60, len(plan) - 100):
        # Nobody knows before growth how much it will be; afterwards the pace says it.
        slack = 0.45 if at < steps // 2 else 0.3
        assert told[at] == pytest.approx(actual[at], rel=slack), at
    assert told[-1] == pytest.approx(0.0, abs=1e-6)
    assert len(heard.texts) == 2
    assert heard.texts[0].startswith("plan: about ")


def test_short_trainings_are_not_worth_a_line() -> None:
    now, heard = 0.0, Heard()
    estimate = Listeners([heard], TimeLeft([PhaseCost("full", 100, 1.0, 1.0)], lambda: now))
    for step in range(1, 101):
        now += 0.1
        estimate.on_step(StepInfo("full", step, 100, 0.1, 20.0, 100, 2**29))
    assert heard.texts == []
    assert heard.infos[49].left == pytest.approx(5.0)


@pytest.mark.parametrize("name", ["draft", "standard", "max", "paper"])
def test_phases_are_those_of_the_training_and_cost_more_with_growth(name: str) -> None:
    config = resolve_settings(name).config
    costs = phase_costs(config, PIXELS)
    assert sum(cost.steps for cost in costs) == total_steps(config)
    assert costs[0].at(0) == 1.0 < costs[0].end == costs[0].at(costs[0].steps)
    assert costs[0].after(0) > costs[0].after(10) > costs[0].after(costs[0].steps) == 0
    steps = sum(costs[0].at(step) for step in range(1, costs[0].steps + 1))
    assert costs[0].after(0) == pytest.approx(steps, rel=0.01)


def test_a_joint_step_costs_what_it_draws() -> None:
    assert joint_cost(Joint(), [1.0, 1.0, 1.0, 1.0]) == 3.0
    assert joint_cost(Joint(), [0.5, 0.5, 0.5, 1.0]) == 2.0
    assert joint_cost(Joint(), [1.0]) == 1.0


def test_steps_are_said_as_what_they_become() -> None:
    assert steps_text(with_steps("standard", 300)) == "300 steps full + 500 joint = 800"
    said = steps_text(with_steps("paper", 300))
    assert said == "300 steps full + 100 unfold L2 + 100 unfold L1 + 100 unfold L0 = 600"


def test_steps_of_smaller_photos_cost_less_and_are_summed_so() -> None:
    asked = {"train.reduced_until": (0.2, 0.6), "train.steps": 400, "levels.steps": 600}
    full, joint = phase_costs(resolve_settings("standard", None, asked).config, PIXELS)
    plain, _ = phase_costs(
        resolve_settings("standard", None, asked | {"train.reduced_until": ()}).config, PIXELS
    )
    shares = [full.at(step) / plain.at(step) for step in (0, 199, 200, 399)]
    assert shares == pytest.approx([0.625, 0.625, 0.7, 0.7])
    assert joint.at(0) / joint.end == joint.at(199) / joint.end == pytest.approx(0.7)
    assert joint.at(200) == joint.end
    for cost in (full, joint):
        for done in (0, 150, 300):
            steps = sum(cost.at(step + 0.5) for step in range(done, cost.steps))
            assert cost.after(done) == pytest.approx(steps)
        assert cost.after(cost.steps) == 0


def test_pixels_of_large_photos_take_most_of_a_step() -> None:
    asked = {"train.reduced_until": (0.3, 0.6), "train.steps": 1000}
    config = resolve_settings("standard", None, asked).config
    small = [phase_costs(config, pixels)[0].small[0][1] for pixels in (0.1 * REST, 8 * REST)]
    assert small[0] > 0.9 and small[1] < 0.2


def test_a_training_without_growth_has_an_estimate_too() -> None:
    config = resolve_settings("standard", None, {"train.growth.until": 0.0}).config
    now, heard = 100.0, Heard()
    full = phase_costs(config, PIXELS)[0]
    estimate = Listeners([heard], TimeLeft(phase_costs(config, PIXELS), lambda: now))
    for step in range(1, full.steps + 1):
        now += 0.1
        estimate.on_step(StepInfo("full", step, full.steps, 0.1, 20.0, 100, 2**29))
    assert full.at(1) == full.at(full.steps) == full.end
    assert full.after(0) == pytest.approx(full.steps * full.end)
    left = heard.infos[-1].left
    assert left is not None and left > 0
