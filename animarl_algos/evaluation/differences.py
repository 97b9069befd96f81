"""Simulated minus recorded, with intervals that hold for all measures together.

The unit is the recording: what happens in several pieces of one recording is one observation.
Each interval is the estimate plus and minus a multiple of its standard error over recordings.
The multiple comes from the null distribution of the largest studentised difference of all measures
(maxT; Westfall and Young 1993, *Resampling-Based Multiple Testing*), so that with a perfect
simulator all intervals together hold zero as often as the level says, however many measures there
are and however they depend on each other.

If a simulator is perfect, the recording of a start is one more rollout of it. The null is found by
exchanging, start by start, the recording with one of the episodes from there. Where recordings are
cut into several pieces it is found by turning the signs of all differences of a recording together.
Differences are studentised in every exchange (Chung and Romano 2013, Ann. Stat. 41, 484). Few
recordings have few exchanges; up to ``FEWEST_ALONE`` recordings the multiple is at least that of a
multivariate Student's t with the correlations of the measures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animarl_algos.evaluation.statistics import FEWEST_ALONE
from animarl_envs.array_types import Bools, Floats, Ints

EXCHANGES = 1000
LEVEL = 0.03  # of all measures together; the two classifiers have the rest of 5 %
PRIMARY_LEVEL = 0.05  # of the primary measures together
FLOOR = 0.1  # of the mean variance over exchanges: values of few recordings may be alike
MIN_RECORDINGS = 3  # for an interval
ROUNDING = 1e-9  # of the largest value: a smaller spread is that of rounding


@dataclass(frozen=True)
class Differences:
    """Means of both sides and the margin of their difference, all ``(measures,)``.

    ``error`` is the standard error of the difference, ``between`` the standard deviation between
    recordings, ``units`` the number of recordings in which a measure is defined. A margin is NaN
    where there are too few of them, or nothing varies.
    """

    recorded: Floats
    simulated: Floats
    margin: Floats
    error: Floats
    between: Floats
    units: Ints

    @property
    def value(self) -> Floats:
        """Simulated minus recorded."""
        return np.asarray(self.simulated - self.recorded)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sides:
    """Recorded and simulated episodes of which differences are taken.

    Parameters
    ----------
    demo
        ``(rollouts,)`` the start of each rollout, copies left out.
    unit
        ``(starts,)`` the recording of each start.
    weight
        ``(starts, measures)`` how much each start counts among those of its recording.
    binary
        ``(measures,)`` whether values are 0 or 1, and then vary even if all are alike.
    primary
        ``(measures,)`` which measures have a level of their own.
    """

    demo: Ints
    unit: Ints
    weight: Floats
    binary: Bools
    primary: Bools

    def by_unit(self, values: Floats, present: Bools) -> Floats:
        """Return the weighted mean of each recording, ``(units, measures)``; NaN without any."""
        owner = np.zeros((int(self.unit.max()) + 1, len(self.unit)))
        owner[self.unit, np.arange(len(self.unit))] = 1.0
        weight = np.where(present, self.weight, 0.0)
        total = owner @ weight
        summed = owner @ (weight * np.where(present, values, 0.0))
        return np.asarray(summed / np.where(total > 0, total, np.nan))


def simultaneous_differences(
    recorded: Floats, simulated: Floats, sides: Sides, rng: np.random.Generator
) -> Differences:
    """Compare ``recorded`` ``(starts, measures)`` with ``simulated`` ``(rollouts, measures)``.

    NaN where a measure is undefined in an episode, which then does not count.
    """
    starts, measures = recorded.shape
    known = np.isfinite(simulated)
    total, count = np.zeros((2, starts, measures))
    np.add.at(total, sides.demo, np.where(known, simulated, 0.0))
    np.add.at(count, sides.demo, known.astype(np.float64))
    mean = total / np.where(count > 0, count, np.nan)
    present = np.isfinite(recorded) & np.isfinite(mean)
    both = [sides.by_unit(side, present) for side in (recorded, mean)]
    gaps = both[1] - both[0]
    units = np.isfinite(gaps).sum(axis=0)
    used = np.unique(sides.demo)
    if len(np.unique(sides.unit[used])) == len(used):
        null = _exchanged(recorded, simulated, total, count, sides, rng)
    else:
        null = _flipped(gaps, rng)
    margin, scale = _margins(gaps, _mean_and_error(gaps, 0)[1], null, both, units, sides, rng)
    between = _mean_and_error(both[0], 0)[1] * np.sqrt(np.maximum(units, 1))
    return Differences(_mean(both[0], 0), _mean(both[1], 0), margin, scale, between, units)


def group_differences(
    first: Floats, second: Floats, sides: tuple[Sides, Sides], rng: np.random.Generator
) -> Differences:
    """Compare recordings of two conditions, ``(starts, measures)`` each: second minus first.

    The null deals recordings to the conditions anew.
    """
    both = [
        side.by_unit(values, np.isfinite(values)) for side, values in zip(sides, (first, second))
    ]
    every = np.concatenate(both)
    known, filled = np.isfinite(every), np.nan_to_num(every)
    labels = np.arange(len(every)) < len(both[0])
    dealt = rng.permuted(np.broadcast_to(labels, (EXCHANGES, len(labels))), axis=1)

    def of(groups: Bools) -> tuple[Floats, Floats]:
        """Mean and variance of the mean of the rows of ``groups`` ``(deals, units)``."""
        number = np.maximum(groups @ known.astype(np.float64), 1.0)
        mean = groups @ filled / number
        variance = np.maximum(groups @ np.square(filled) / number - np.square(mean), 0.0)
        return mean, variance / np.maximum(number - 1.0, 1.0)

    moved = [of(groups) for groups in (dealt, ~dealt)]
    null = moved[1][0] - moved[0][0], np.sqrt(moved[0][1] + moved[1][1])
    own = [of(groups[None]) for groups in (labels, ~labels)]
    error = np.sqrt(own[0][1] + own[1][1])[0]
    units = np.minimum(*(np.isfinite(side).sum(axis=0) for side in both))
    residuals = np.concatenate([side - _mean(side, 0) for side in both])
    margin, scale = _margins(residuals, error, null, both, units, sides[0], rng)
    between = _mean_and_error(both[0], 0)[1] * np.sqrt(np.isfinite(both[0]).sum(axis=0))
    return Differences(_mean(both[0], 0), _mean(both[1], 0), margin, scale, between, units)


def _margins(
    gaps: Floats,
    error: Floats,
    null: tuple[Floats, Floats],
    both: list[Floats],
    units: Ints,
    sides: Sides,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return the margin of every measure and the standard error that it is a multiple of."""
    pooled = np.concatenate(both)
    spread = np.nan_to_num(_mean_and_error(pooled, 0)[1])
    floor = np.nan_to_num(FLOOR * _mean(np.square(null[1]), 0))
    floor = np.where(floor <= np.square(ROUNDING * spread), FLOOR * np.square(spread), floor)
    scales = [np.sqrt(np.square(one) + floor) for one in (error, null[1])]
    likely = (units * _mean(pooled, 0) + 1) / (units + 2)  # never 0 or 1
    with np.errstate(invalid="ignore", divide="ignore"):
        least = np.where(sides.binary, np.sqrt(likely * (1 - likely) / units), 0.0)
        scale, scale_null = (np.maximum(one, least) for one in scales)
        size = np.nanmax(np.abs(pooled), axis=0, initial=0.0)
        known = (scale > ROUNDING * size) & (scale > 0) & (units >= MIN_RECORDINGS)
        studentised = np.nan_to_num(null[0] / scale_null)
        width = studentised.std(axis=0)
        width = np.where(width > ROUNDING, width, 1.0)
    largest = np.abs(studentised / width)
    few = len(gaps) <= FEWEST_ALONE
    student = _largest_t(gaps, rng) if few else np.zeros((1, len(error)))
    margin = np.full(len(error), np.nan)
    for chosen, level in ((~sides.primary, LEVEL), (sides.primary, PRIMARY_LEVEL)):
        chosen = chosen & known
        if chosen.any():
            multiple = np.quantile(largest[:, chosen].max(axis=1), 1 - level)
            of_t = np.quantile(student[:, chosen].max(axis=1), 1 - level)
            margin[chosen] = np.maximum(multiple * width, of_t)[chosen] * scale[chosen]
    return margin, np.asarray(scale)


def _exchanged(
    recorded: Floats,
    simulated: Floats,
    total: Floats,
    count: Floats,
    sides: Sides,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return means and errors of differences, each ``(EXCHANGES, measures)``, if exchanged.

    In every exchange one of the episodes of each start, recorded or simulated, is called recorded.
    """
    used = np.unique(sides.demo)
    chosen = np.empty((EXCHANGES, len(used)), dtype=np.int64)
    for place, start in enumerate(used.tolist()):
        members = np.append(start, len(recorded) + np.flatnonzero(sides.demo == start))
        chosen[:, place] = members[rng.integers(len(members), size=EXCHANGES)]
    own = np.where(np.isfinite(recorded), recorded, 0.0)[used]
    total, count = total[used] + own, count[used] + np.isfinite(recorded)[used]
    means, errors = np.empty((2, EXCHANGES, recorded.shape[1]))
    for measure, column in enumerate(np.concatenate([recorded, simulated]).T):
        taken = column[chosen]
        known = np.isfinite(taken)
        left = count[:, measure] - known
        rest = total[:, measure] - np.where(known, taken, 0.0)
        gap = rest / np.where(left > 0, left, np.nan) - taken
        means[:, measure], errors[:, measure] = _mean_and_error(gap, 1)
    return means, errors


def _flipped(gaps: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the same, of differences ``(units, measures)`` of which signs are turned."""
    known = np.isfinite(gaps)
    number = np.maximum(known.sum(axis=0), 1)
    signs = rng.choice([-1.0, 1.0], size=(EXCHANGES, len(gaps)))
    means = signs @ np.where(known, gaps, 0.0) / number
    square = np.square(np.where(known, gaps, 0.0)).sum(axis=0) / number
    error = np.sqrt(np.maximum(square - np.square(means), 0.0) / np.maximum(number - 1, 1))
    return np.asarray(means), np.asarray(error)


def _largest_t(gaps: Floats, rng: np.random.Generator) -> Floats:
    """Return draws ``(EXCHANGES, measures)`` of Student's t with the correlations of ``gaps``."""
    centred = np.nan_to_num(gaps - _mean(gaps, 0))
    length = np.sqrt(np.square(centred).sum(axis=0))
    centred = centred / np.where(length > 0, length, 1.0)
    freedom = max(len(gaps) - 1, 1)
    draws = rng.normal(size=(EXCHANGES, len(gaps))) @ centred
    return np.asarray(np.abs(draws) / np.sqrt(rng.chisquare(freedom, EXCHANGES) / freedom)[:, None])


def _mean(values: Floats, axis: int) -> Floats:
    """Mean of what is defined; NaN where nothing is."""
    number = np.isfinite(values).sum(axis=axis)
    return np.asarray(np.nansum(values, axis=axis) / np.where(number > 0, number, np.nan))


def _mean_and_error(values: Floats, axis: int) -> tuple[Floats, Floats]:
    """Mean, and its standard error, of what is defined; the error of one value is NaN."""
    number = np.isfinite(values).sum(axis=axis)
    mean = _mean(values, axis)
    square = np.nansum(np.square(values - np.expand_dims(mean, axis)), axis=axis)
    freedom = np.where(number > 1, number * (number - 1), np.nan)
    return mean, np.asarray(np.sqrt(square / freedom))
