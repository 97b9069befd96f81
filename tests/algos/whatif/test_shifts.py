"""Intervals of the shifts of what-if answers."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recordings import group

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.whatif.shifts import calibrated, tips_over, widen_shift_of_share
from benchmarks.whatif_bars import SMALLER, calibration

STARTS = 10
DEMOS = group(1, STARTS)
EVERY = np.ones(STARTS, dtype=bool)


def widened(before: list[float], after: list[float], shift: Interval) -> Interval:
    was, now = np.array(before), np.array(after)
    demo = np.arange(STARTS)
    return widen_shift_of_share(shift, was, now, demo, test=DEMOS, counts=EVERY)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_share_that_no_start_changes_has_a_width(value: float) -> None:
    same = [value] * STARTS
    found = widened(same, same, Interval(0.0, 0.0, 0.0))
    edge = 2.2622**2 / (STARTS + 2.2622**2)  # Wilson's, with Student's t of ten starts
    assert found.low == pytest.approx(-edge, abs=1e-4)
    assert found.high == pytest.approx(edge, abs=1e-4)


def test_share_of_newcombe_for_pairs() -> None:
    before = [1.0] * 4 + [0.0] * 6
    after = [1.0] * 6 + [0.0] * 4
    found = widened(before, after, Interval(0.2, 0.19, 0.21))
    together = np.corrcoef(before, after)[0, 1]
    assert together > 0.6
    assert -0.2 < found.low < 0.0 < 0.4 < found.high < 0.6
    apart = widened(before, after[::-1], Interval(0.2, 0.19, 0.21))
    assert apart.low < found.low and apart.high > found.high  # pairs that move together tell more
    wide = widened(before, after, Interval(0.2, -0.9, 0.9))
    assert (wide.low, wide.high) == (-0.9, 0.9)


def test_calibrated_intervals_are_those_of_the_published_truth() -> None:
    table = pd.read_csv(Path(__file__).parents[3] / "docs/results/whatif/whatif_truth.csv")
    found = calibration(table).set_index("set")
    assert found.loc[SMALLER, "rows"] == 28 and found.loc[SMALLER, "calibrated"] < 0.5
    found = found.drop(SMALLER)
    assert len(found) == 6 and (found["wider"] >= 1.0).all()
    assert found.loc["all", "calibrated"] > 0.9 > found.loc["all", "raw"]
    assert (found["calibrated"] > 0.88).all() and (found["needed"] < 1.1).all()
    apart = calibration(table.assign(second_shift=table["predicted"] + 1e9)).set_index("set")
    assert (apart["wider"] > 1e3).all() and (apart["calibrated"] == 1.0).all()
    row = {"shift": 2.0, "low": 1.0, "high": 4.0, "other_reading": 2.0}
    assert calibrated(row) == (2.0, 1.0, 4.0)
    assert calibrated(row | {"other_reading": np.nan}) == (2.0, 1.0, 4.0)
    found = calibrated(row | {"other_reading": 5.0, "second_shift": 4.0})
    assert found == pytest.approx((2, 2 - 14**0.5, 2 + 17**0.5))
    cue = {"trained_miss": 3.0, "trained_margin": 3.0}  # of a condition
    assert calibrated(row | cue) == pytest.approx((5, 5 - 10**0.5, 5 + 13**0.5))
    assert calibrated(row | cue | {"trained_miss": np.nan}) == (2.0, 1.0, 4.0)


@pytest.mark.parametrize(
    ("thrust", "speed", "tips"),
    [
        (1.2, 1.2**1.95, False), (1.2, 1.2**2.05, True), (1.2, 3.2, True),
        (0.8, 0.8**1.95, False), (0.8, 0.8**2.05, True), (0.8, 0.15, True), (0.8, 0.0, True),
        (1.001, 1.1, False), (1.001, 1.11, True), (2.0, float("nan"), False),
    ],
)  # fmt: skip
def test_a_speed_that_changes_more_than_the_square_of_the_thrust_tips_over(
    thrust: float, speed: float, tips: bool
) -> None:
    assert tips_over(thrust, speed) is tips
