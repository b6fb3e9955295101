"""What a table says of several seeds."""

from research.suites.bdrate import BdRate
from research.suites.table import rate_text


def test_a_rate_names_the_range_that_all_seeds_share() -> None:
    assert rate_text([]) == "n/a"
    rates = [BdRate(-10.0, 18.0, 19.5), BdRate(-12.0, 18.5, 19.0)]
    assert rate_text(rates) == "-11.0 ± 1.4 % (18.5 to 19.0 dB)"


def test_a_rate_of_seeds_whose_ranges_are_apart_says_so() -> None:
    rates = [BdRate(-80.0, 18.1, 18.3), BdRate(-20.0, 18.7, 18.9)]
    assert rate_text(rates) == "-50.0 ± 42.4 % (over no dB that all seeds share)"
