"""What a report says in words follows from its numbers, and the numbers have their digits."""

from __future__ import annotations

import pandas as pd
import pytest

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report.sentences import cautions, headline, number, with_interval


def comparison(mean: float, low: float, high: float) -> pd.DataFrame:
    """A table of one method, its difference to the recordings, and random actions beside it."""
    rows = []
    for method, metric in [("bc", "path_length"), ("bc", "dtw"), ("random", "dtw")]:
        row = {"method": method, "metric": metric, "counting": "all", "rollouts": 5, "seeds": 1}
        keys = ("mean", "to_recorded", "kde", "kde_null", "wasserstein")
        for key in keys:
            row |= {key: mean, f"{key}_low": low, f"{key}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def pairs(low: float, high: float) -> pd.DataFrame:
    """Random actions minus BC in DTW distance."""
    row = {"metric": "dtw", "counting": "all", "first": "random", "second": "bc"}
    ends = {"difference": (low + high) / 2, "difference_low": low, "difference_high": high}
    return pd.DataFrame([row | ends])


@pytest.mark.parametrize(
    ("mean", "low", "high", "other", "said"),
    [
        (2.0, 1.0, 3.0, (1.0, 2.0), ["longer than recorded", "closer than random"]),
        (-2.0, -3.0, -1.0, (-2.0, -1.0), ["2.0 [1.0, 3.0] arena units shorter", "farther than"]),
        (0.5, -1.0, 2.0, (-1.0, 3.0), ["not told apart", "not told apart from random"]),
    ],
)
def test_claims_follow_the_numbers(
    mean: float, low: float, high: float, other: tuple[float, float], said: list[str]
) -> None:
    text = " ".join(headline(comparison(mean, low, high), pairs(*other), "bc"))
    for words in said:
        assert words in text


def test_cautions_say_what_limits_the_conclusions() -> None:
    table = comparison(1.0, 0.0, 2.0)
    one = cautions(table, "bc", synthetic=True)
    assert "synthetic" in one[0] and "One training seed" in one[1]
    assert cautions(table.assign(seeds=3), "bc", synthetic=False)[0].startswith("Only 3")
    assert cautions(table.assign(seeds=5), "bc", synthetic=False) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Interval(1.2345, 1.0, 1.5), "1.23 [1.00, 1.50]"),
        (Interval(-12.34, -15.0, -9.0), "\u221212.3 [\u221215.0, \u22129.0]"),
        (Interval(112.3, 92.0, 133.0), "112 [92, 133]"),
        (Interval(-0.2, -20.0, 18.0), "0 [\u221220, 18]"),
        (Interval(0.25, 0.25, 0.25), "0.250 [0.250, 0.250]"),
        (Interval(0.5, float("nan"), float("nan")), "0.500"),
        (Interval(float("nan"), 0.0, 0.0), "\u2013"),
    ],
)
def test_numbers_have_the_digits_their_interval_allows(value: Interval, text: str) -> None:
    assert with_interval(value) == text


def test_numbers_alone_have_three_digits() -> None:
    assert [number(v) for v in (0.0, 1234.5, -0.5, 3e-7, float("nan"))] == [
        "0", "1234", "\u22120.500", "3e\u221207", "\u2013",
    ]  # fmt: skip
