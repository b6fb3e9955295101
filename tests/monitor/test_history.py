"""What the page of a training is told."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import pytest

from gsynopsis.monitor.history import POINTS, TrainingHistory, Version
from gsynopsis.training.observer import StepInfo

STEP = StepInfo("full", 1, 100, 0.5, 20.0, 5, 0)


def test_steps_count_over_all_phases_and_those_of_a_run_that_goes_on() -> None:
    course = TrainingHistory([("full", 100), ("joint", 50), ("finish", 10)])
    assert (course.step, course.report()["steps"]) == (0, 160)
    course.add(replace(STEP, phase="joint", step=7, steps=50))
    assert course.step == course.report()["step"] == 107


def test_the_time_left_is_what_the_steps_say() -> None:
    course = TrainingHistory([("full", 100)])
    assert course.report()["remaining"] is None
    course.add(STEP)
    assert course.report()["remaining"] is None
    course.add(replace(STEP, step=2, left=12.5))
    assert course.report()["remaining"] == 12.5


@pytest.mark.parametrize("steps", [3, 200, 201, 5000])
def test_the_curve_stays_short_and_reaches_over_all_steps(steps: int) -> None:
    course = TrainingHistory([("full", steps)])
    for step in range(1, steps + 1):
        course.add(replace(STEP, step=step, steps=steps, loss=1 / step))
    curve = course.report()["curve"]
    assert isinstance(curve, list)
    places = [place for place, _ in curve]
    assert min(steps, POINTS // 2) <= len(curve) <= POINTS
    assert len({b - a for a, b in pairwise(places)}) == 1, "evenly apart"
    assert places[0] <= steps // 10 + 1 and places[-1] > 0.9 * steps
    assert curve[-1][1] == pytest.approx(1 / places[-1], abs=1e-6)


def test_what_is_not_known_or_not_finite_is_null_in_the_json() -> None:
    course = TrainingHistory([("full", 100)])
    course.add(replace(STEP, loss=math.nan))
    course.version = Version(1, 1000, None, 2)
    report = json.loads(json.dumps(course.report(), allow_nan=False))
    assert report["loss"] is None and report["held_out"] is None and report["curve"] == []
    assert report["version"] == {"step": 1, "bytes": 1000} and report["finished"] is False
