"""Shifts of what-if answers: their means over starts, their null, and what may be said of them."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.statistics import (
    Interval,
    bootstrap_mean,
    cells,
    share_margins,
    student_t,
)
from animarl_algos.whatif.extrapolation import Caution
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations

CUE_LEVEL = 0.05  # of a cue's shift among those of permuted labels
RISES, FALLS = "rises", "falls"
CANNOT_TELL = "cannot be told from these recordings"
TIPPING, SMALL = 2.0, 0.05
"""Speeds that change by more than this power of the thrust tip over; smaller changes of a thrust
count as this one."""
NO_INTERVAL = "one test start: no interval"


def judge(row: Mapping[Any, Any], of_a_cue: bool) -> str:
    """Return what a shift is, in a few words: :data:`RISES`, :data:`FALLS`, or why it is neither.

    Recordings of two conditions differ by chance too, and policies learn that. So the shift of a
    cue is no finding without the shifts of runs with permuted conditions beside it.
    """
    if row["warning"] == Caution.RED:
        return "a guess"
    if np.isnan(row["low"]):
        return NO_INTERVAL
    if disagrees(row):
        return CANNOT_TELL
    if not (row["low"] > 0 or row["high"] < 0):
        return "not clear of zero"
    if abs(row["shift"]) < abs(row["gap"]):
        return "smaller than the gap"
    if of_a_cue and not np.isfinite(row["p"]):
        return f"without a null: add --permutations {round(1 / CUE_LEVEL)}"
    if row["p"] > CUE_LEVEL:
        return "as by chance"
    return RISES if row["shift"] > 0 else FALLS


def disagrees(row: Mapping[Any, Any]) -> bool:
    """Return whether a simulator with other inputs answers otherwise, beyond both intervals.

    No simulator is trusted more closely than it is near the recordings in the unchanged world.
    """
    other = row.get("second_shift", math.nan)
    if not np.isfinite([other, row["low"]]).all():
        return False
    margins = [
        max(row[shift] - row[low], row[high] - row[shift])
        for shift, low, high in (
            ("shift", "low", "high"), ("second_shift", "second_low", "second_high"),
        )
    ]  # fmt: skip
    return bool(abs(other - row["shift"]) > math.hypot(*margins, row["gap"], row["second_gap"]))


def tips_over(thrust: float, speed: float) -> bool:
    """Return whether a ``speed`` changes far more than the ``thrust``, both factors on what was.

    Steady pushes make a speed in proportion to the thrust. A simulator of an animal that rests can
    tip over between rest and motion, so that a small change has a large effect.
    """
    if not 0.0 < speed < math.inf:
        return speed == 0.0
    return abs(math.log(speed)) > TIPPING * max(abs(math.log(thrust)), math.log1p(SMALL))


def distances(row: Mapping[Any, Any]) -> list[float]:
    """Return how far an answer is from others: by another reading of a body, by other inputs."""
    apart = [row.get(name, math.nan) - row["shift"] for name in ("other_reading", "second_shift")]
    return [one for one in apart if np.isfinite(one)]


def calibrated(row: Mapping[Any, Any]) -> tuple[float, float, float]:
    """Return a shift and the interval that is as wide as such answers have been wrong.

    It grows with the :func:`distances` from other answers. The shift by a condition is corrected by
    what the simulator misses of it in the recordings that were learned from; the chance of those
    is in its interval.
    """
    apart, shift = distances(row), row["shift"]
    if np.isfinite(miss := row.get("trained_miss", math.nan)):
        apart, shift = [row["trained_margin"]], shift + miss
    below, above = (math.hypot(row["shift"] - row[end], *apart) for end in ("low", "high"))
    return shift, shift - below, shift + above


def widen_for_family(shift: Interval, answers: int, units: int) -> Interval:
    """Return an interval that holds together with those of the other answers to one question.

    Bonferroni's, by Student's t over so many ``units``.
    """
    if answers < 2 or units < 2:
        return shift
    ends = [student_t(1.0 - 0.025 / number, units - 1) for number in (answers, 1)]
    wider = float(ends[0] / ends[1])
    low, high = (shift.estimate + wider * (end - shift.estimate) for end in (shift.low, shift.high))
    return replace(shift, low=low, high=high)


def shift_between_conditions(
    values: Floats, treated: Bools, recording: NDArray[np.str_]
) -> tuple[float, float]:
    """Return how far recordings of a condition lie above the others, and the margin of that (95 %).

    ``(episodes,)`` each; the unit is the recording (Welch's t).
    """
    groups = []
    for side in (treated, ~treated):
        side = side & np.isfinite(values)
        units = np.unique(recording[side], return_inverse=True)[1]
        groups.append(np.bincount(units, values[side]) / np.bincount(units))
    if min(map(len, groups)) < 2:
        return math.nan, math.nan
    squares = [float(group.var(ddof=1)) / len(group) for group in groups]
    total = sum(squares)
    by_group = [square**2 / (len(group) - 1) for square, group in zip(squares, groups, strict=True)]
    freedom = total**2 / sum(by_group) if total > 0 else 1.0
    shift = float(groups[0].mean() - groups[1].mean())
    return shift, float(student_t(0.975, freedom)) * math.sqrt(total)


def share_as_large(shifts: Floats, null: Floats) -> Floats:
    """Return ``p`` of each quantity's shift: how often permuted conditions move any of them as far.

    An answer has several quantities, which are tested together: a shift counts in units of what
    permuted conditions move its quantity by (Westfall and Young 1993, the largest of each network).

    Parameters
    ----------
    shifts
        ``(quantities,)``.
    null
        ``(networks, quantities)``.
    """
    spread = np.sqrt(np.mean(np.square([*null, shifts]), axis=0))
    spread[spread == 0] = 1.0  # what nobody moves stays where it is
    largest = (np.abs(null) / spread).max(axis=1)
    as_large = (~(largest[:, None] < np.abs(shifts) / spread)).sum(axis=0)
    return np.asarray((1 + as_large) / (1 + len(null)))


def mean_over_starts(
    values: Floats,
    demo: Ints,
    *,
    runs: int,
    test: Demonstrations,
    rng: np.random.Generator,
    counts: Bools,
) -> Interval:
    """Return a mean with its interval over recordings and training runs.

    Parameters
    ----------
    values, demo, counts
        ``(rollouts,)`` of all runs, one after the other: the value, its start, whether it counts.
    test
        The starts; those that were cut from one recording are one unit.
    """
    recording = units_of_starts(demo, test, counts)
    seed = np.repeat(np.arange(runs), len(values) // runs)
    data = cells(values, seed, recording[demo], int(recording.max()) + 1, counts)
    return bootstrap_mean(data, rng)


def chance_error(values: Floats, start: Ints, counts: Bools) -> float:
    """Return the half-width of the 95 % interval of a mean, from the chance of its rollouts alone.

    It says how far the mean of other rollouts from the same starts would be; NaN where no start has
    two of them.

    Parameters
    ----------
    values, start, counts
        ``(rollouts,)``: the value, a number for its start and network, whether it counts.
    """
    counts = counts & np.isfinite(values)
    values, place = values[counts], np.unique(start[counts], return_inverse=True)[1]
    number = np.bincount(place)
    if not (number > 1).any():
        return float("nan")
    apart = values - (np.bincount(place, values) / number)[place]
    several = number > 1
    spread = np.bincount(place, apart**2)[several] / (number[several] - 1)
    within = np.average(spread, weights=number[several])
    freedom = int((number[several] - 1).sum())
    return float(student_t(0.975, freedom) * np.sqrt(within / len(values)))


def widen_shift_of_share(
    shift: Interval,
    before: Floats,
    after: Floats,
    demo: Ints,
    *,
    test: Demonstrations,
    counts: Bools,
) -> Interval:
    """Return the shift of a share with an interval at least as wide as Newcombe's for pairs.

    Resamples of starts that all do the same have no width, though ten starts cannot show that none
    in a hundred does otherwise. (Newcombe 1998, Stat. Med. 17, 2635, method 10, with the margins of
    :func:`~animarl_algos.evaluation.statistics.share_margins` over recordings.)
    """
    counts = counts & np.isfinite(before) & np.isfinite(after)
    place = units_of_starts(demo, test, counts)[demo[counts]]
    number = np.bincount(place)
    was, now = (
        np.bincount(place, values[counts])[number > 0] / number[number > 0]
        for values in (before, after)
    )
    if len(was) < 2:
        return shift
    below_was, above_was = share_margins(float(was.mean()), was)
    below_now, above_now = share_margins(float(now.mean()), now)
    together = float(np.corrcoef(was, now)[0, 1]) if was.std() > 0 < now.std() else 0.0

    def joined(one: float, other: float) -> float:
        return math.sqrt(max(0.0, one**2 - 2.0 * together * one * other + other**2))

    low = shift.estimate - joined(below_now, above_was)
    high = shift.estimate + joined(above_now, below_was)
    return replace(shift, low=min(shift.low, low), high=max(shift.high, high))


def units_of_starts(demo: Ints, test: Demonstrations, counts: Bools) -> Ints:
    """Return the recording of each start; the start itself if all that count are of one."""
    _, recording = np.unique(test.recording, return_inverse=True)
    single = len(np.unique(recording[demo[counts]])) < 2
    return np.arange(len(test)) if single else recording
