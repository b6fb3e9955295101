"""Cells of the tables of rivals: what they say of curves that share much, little or nothing."""

from typing import Any

import pytest

from benchmarks.train import standard
from benchmarks.train.rivals import short_rate

Row = dict[str, Any]


def rows(method: str, psnr: list[float], sizes: float, seeds: int = 1) -> list[Row]:
    return [
        {
            "method": method,
            "seed": seed,
            "level": level,
            "bytes_compact": sizes * 2**level,
            "psnr_full": value,
        }
        for seed in range(seeds)
        for level, value in enumerate(psnr)
    ]


OURS = rows("ours", [25.0, 27.0, 28.0, 28.5], 1000)


def test_a_rival_that_shares_enough_has_a_rate_and_how_far_it_goes_on() -> None:
    beaten = short_rate([*OURS, *rows("gode", [24.0, 26.0, 27.0, 28.0], 2000)], "gode")
    assert beaten.startswith("-") and " %, 0." in beaten and "up to" not in beaten
    ahead = short_rate([*OURS, *rows("gode", [25.0, 27.0, 28.0, 30.0], 2000)], "gode")
    assert "up to +1.5 dB" in ahead and "(+" in ahead


def test_a_rival_that_shares_little_has_none() -> None:
    near = short_rate([*OURS, *rows("gode", [27.8, 28.2, 29.0, 29.4], 9000)], "gode")
    assert near.startswith("n/a, 0.7 dB shared, ") and near.endswith("up to +0.9 dB")
    above = short_rate([*OURS, *rows("gode", [29.0, 30.0], 9000)], "gode")
    assert above == "above, up to +1.5 dB"
    assert short_rate([*OURS, *rows("gode", [20.0, 21.0], 9000)], "gode") == "below"


def test_3dgs_is_held_against_its_authors_figures() -> None:
    own = [{**row, "scene": "garden"} for row in rows("gaussians", [27.3], 1)]
    far = [{**row, "scene": "truck"} for row in rows("gaussians", [24.0], 1)]
    told = standard.protocol([*own, *far])
    assert told == (
        "3DGS: truck 24.00 dB (25.2: **not as published**), garden 27.30 dB (27.4: as published)."
    )
    assert standard.protocol(OURS_ELSEWHERE) == (
        "3DGS: none of the scenes whose figures are known."
    )


OURS_ELSEWHERE = [{**row, "scene": "fox"} for row in OURS]


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_bytes_of_the_worst_quality_are_named(shift: float) -> None:
    other = rows("gode", [25.0, 27.0, 28.0, 28.5], 1000 * 2**shift)
    assert short_rate([*OURS, *other], "gode").endswith(f", {2**-shift:.2f}")
