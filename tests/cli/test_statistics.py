"""The interval under every success figure."""

import pytest

from tandem.statistics import mean, percent, share, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe (1998), Statistics in Medicine 17, table I: Wilson without continuity correction
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_agrees_with_published_values(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_of_200_of_200_promises_no_certainty() -> None:
    low, high = wilson(200, 200)
    assert low == pytest.approx(0.98115, abs=5e-5)
    assert high == 1.0


def test_wilson_is_symmetric_in_success_and_failure() -> None:
    low, high = wilson(3, 50)
    assert wilson(47, 50) == pytest.approx((1 - high, 1 - low))


def test_no_trials_tell_nothing_and_impossible_counts_are_refused() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    for counts in ((3, 2), (-1, 5), (0, -1)):
        with pytest.raises(ValueError, match="impossible"):
            wilson(*counts)


def test_empty_samples_have_no_mean_and_no_share() -> None:
    assert mean([]) is None
    assert share(0, 0) == 0.0


def test_percent_shows_share_interval_and_counts() -> None:
    assert percent(197, 200) == "98.5 % [95.7, 99.5] (197/200)"
