"""A table's words on several seeds."""

from research.suites.bdrate import BdRate
from research.suites.table import rate_text, rates_of, spread_of


def rows_of(
    method: str, shift: float, sizes: float, wobble: float = 0.0
) -> list[dict[str, object]]:
    return [
        {
            "method": method,
            "seed": seed,
            "level": level,
            "bytes_compact": sizes * 2**level,
            "psnr_full": 20 + shift + level * 0.5 + seed * wobble,
        }
        for seed in (0, 1)
        for level in range(4)
    ]


def test_a_rate_names_the_range_that_all_seeds_share() -> None:
    assert rate_text([]) == "n/a"
    rates = [BdRate(-10.0, 18.0, 19.5), BdRate(-12.0, 18.5, 19.5)]
    assert rate_text(rates) == "-11.0 ± 1.4 % (18.5 to 19.5 dB)"


def test_curves_that_share_less_than_a_decibel_have_no_rate() -> None:
    ours = rows_of("ours", 0, 1000)
    near, far = rows_of("near", 0.4, 2000), rows_of("far", 0.6, 2000)
    found = rates_of([*ours, *near], "ours", "near", "full")
    assert len(found) == 2 and found[0].high - found[0].low > 1
    assert rates_of([*ours, *far], "ours", "far", "full") == []


def test_curves_that_share_less_than_three_spreads_have_no_rate() -> None:
    ours, wild = rows_of("ours", 0, 1000), rows_of("wild", 0, 2000, 0.6)
    assert abs(spread_of(wild, "wild", "full") - 0.6 / 2**0.5) < 1e-9
    # The seeds share 0.9 dB; with as much noise in the other 1.5 dB would not do either.
    assert rates_of([*ours, *wild], "ours", "wild", "full") == []
    noisy = rows_of("noisy", -0.2, 2000, 0.4)
    assert rates_of([*ours, *noisy], "ours", "noisy", "full")
