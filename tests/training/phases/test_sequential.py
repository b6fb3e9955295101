"""The schedule of anchors to keep while one coarser level is chosen."""

import math

from gsynopsis.training.phases.sequential import cosine, keep_target


def test_cosine_meets_its_ends() -> None:
    assert cosine(1.0, 0.4, -1) == 1.0
    assert math.isclose(cosine(1.0, 0.4, 0.5), 0.7)
    assert math.isclose(cosine(1.0, 0.4, 2), 0.4)


def test_the_keep_target_falls_from_5_to_65_percent_of_the_steps() -> None:
    assert keep_target(500, 10_000, 0.7) == 1.0
    assert math.isclose(keep_target(6_500, 10_000, 0.7), 0.7)
    falling = [keep_target(s, 10_000, 0.7) for s in range(0, 10_000, 100)]
    assert falling == sorted(falling, reverse=True)
