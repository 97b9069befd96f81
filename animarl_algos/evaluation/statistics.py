"""Statistics of rollouts against recordings: arrays and a seeded generator in, numbers out.

Rollouts are nested: several from each recorded start, several starts, several training seeds.
Repetitions from one start are never treated as independent; what varies are demonstrations and
seeds, crossed. What is compared on the same demonstrations, or the same networks, is subtracted
there first, which is what makes a comparison paired. How intervals are made of that is in
:mod:`animarl_algos.evaluation.studentised`.

With a single seed an interval speaks of demonstrations only, for the one network that was trained.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.cells import Cells, cells
from animarl_algos.evaluation.studentised import (
    CONFIDENCE,
    RESAMPLES,
    Draws,
    Part,
    draw_weights,
    margins,
    seed_square,
    share_margins,
)
from animarl_envs.errors import InputError

__all__ = [
    "CONFIDENCE", "RESAMPLES", "UNDEFINED", "Cells", "Draws", "Interval", "bootstrap_difference",
    "bootstrap_mean", "cells", "covers", "draw_weights", "percentile_interval", "shared_starts",
    "within_intervals",
]  # fmt: skip

Floats = NDArray[np.float64]

NETWORK_ONLY = "this network only"
NETWORKS_ONLY = "these networks only"
TRAINING = "training runs like these"

NO_VALUE = "no episode counts"
ONE_DEMO = "one demonstration: no spread to be seen"
NOTHING_SHARED = "no shared start"
ONE_METHOD = "a single method"
FEW_DEFINED = "too few resamples have a value"


@dataclass(frozen=True)
class Interval:
    """An estimate with its interval; NaN where it is not defined, and then a ``reason``."""

    estimate: float
    low: float
    high: float
    reason: str = ""

    @property
    def excludes_zero(self) -> bool:
        return self.low > 0 or self.high < 0

    def overlaps(self, other: Interval) -> bool:
        """Whether the two intervals share a value; undefined intervals overlap everything."""
        return not (self.high < other.low or other.high < self.low)

    @classmethod
    def without_ends(cls, estimate: float, reason: str) -> Interval:
        return cls(estimate, math.nan, math.nan, reason)


UNDEFINED = Interval(math.nan, math.nan, math.nan)


def percentile_interval(
    estimate: float, resampled: Floats, confidence: float = CONFIDENCE
) -> Interval:
    """Percentile interval of resampled estimates, for what has no standard error of its own.

    It is undefined (NaN) when more than one resample in twenty has no value. It is too short for
    means of few or of skewed values: see :func:`bootstrap_mean`.
    """
    defined = resampled[np.isfinite(resampled)]
    if not math.isfinite(estimate):
        return Interval.without_ends(estimate, NO_VALUE)
    if len(defined) < 0.95 * len(resampled):
        return Interval.without_ends(estimate, FEW_DEFINED)
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(defined, [tail, 100.0 - tail])
    return Interval(float(estimate), float(low), float(high))


# -- intervals ------------------------------------------------------------------------------------


def bootstrap_mean(
    data: Cells,
    rng: np.random.Generator | Draws,
    resamples: int = RESAMPLES,
    *,
    share: bool = False,
) -> Interval:
    """Mean over rollouts with its interval over demonstrations and seeds.

    Parameters
    ----------
    rng
        A generator, or draws that several statistics share.
    share
        The values are 0 or 1: the interval stays between them, and has a width even if all
        episodes end alike.
    """
    present = data.of(data.starts)
    if not present.counts.size:
        return Interval.without_ends(math.nan, NO_VALUE)
    if present.sums.shape[1] < 2:
        return Interval.without_ends(present.mean, ONE_DEMO)
    deviations = present.deviations
    if share:
        mean = np.asarray(present.mean)
        by_demos = share_margins(mean, deviations.mean(axis=0) + mean)
        by_seeds = seed_square([[deviations]])
        below, above = (np.sqrt(np.square(side) + by_seeds) for side in by_demos)
        return _around(present.mean, below, above, least=0.0, most=1.0)
    return _around(present.mean, *margins([Part(deviations)], _draws(rng, resamples)))


def bootstrap_difference(
    first: Cells,
    second: Cells,
    rng: np.random.Generator | Draws,
    resamples: int = RESAMPLES,
    *,
    same_seeds: bool = False,
    same_demos: bool = True,
    share: bool = False,
) -> Interval:
    """``mean(first) - mean(second)`` with its interval.

    Parameters
    ----------
    same_seeds
        Whether seed ``i`` of both is one and the same trained network, asked two questions, so that
        what a network adds to both cancels. Recordings are cells with one row.
    same_demos
        Whether demonstration ``i`` of both is the same, so that the difference is paired. Only
        starts that both have count then, each as much as any other.
    share
        The values are 0 or 1: the interval is Newcombe's hybrid score interval (1998, Stat. Med.
        17, 873, method 10) of both shares, which stays between -1 and 1 and always has a width.
    """
    if same_demos and first.sums.shape[1] != second.sums.shape[1]:
        raise InputError("paired samples need the same demonstrations")
    if same_seeds and len(first.sums) != len(second.sums):
        raise InputError(
            f"the same networks cannot be {len(first.sums)} and {len(second.sums)} seeds: leave "
            "out those that were asked one question only"
        )
    empty = min(first.counts.sum(), second.counts.sum()) == 0
    if same_demos and same_seeds:
        both = first.present & second.present
        gap = np.where(both, first.cell_means - second.cell_means, 0.0)
        pair = [Cells(gap, both.astype(np.float64)).even]
        if both.any() and not share:
            return bootstrap_mean(pair[0], rng, resamples)
    elif same_demos:
        pair = shared_starts([first, second])
    else:
        rows = first.present.any(axis=1) & second.present.any(axis=1) if same_seeds else slice(None)
        chosen = [Cells(data.sums[rows], data.counts[rows]) for data in (first, second)]
        pair = [data.of(data.starts) for data in chosen]
    if min(data.counts.sum() for data in pair) == 0:
        return Interval.without_ends(math.nan, NO_VALUE if empty else NOTHING_SHARED)
    estimate = pair[0].mean - pair[1].mean
    if min(data.sums.shape[1] for data in pair) < 2:
        return Interval.without_ends(estimate, ONE_DEMO)
    if share:
        one, other = (bootstrap_mean(data, rng, resamples, share=True) for data in pair)
        below = math.hypot(one.estimate - one.low, other.high - other.estimate)
        above = math.hypot(one.high - one.estimate, other.estimate - other.low)
        return _around(estimate, np.asarray(below), np.asarray(above), least=-1.0, most=1.0)
    parts = [
        Part(
            sign * data.deviations,
            seeds=0 if same_seeds else number,
            demos=0 if same_demos else number,
        )
        for number, (sign, data) in enumerate(zip((1.0, -1.0), pair))
    ]
    return _around(estimate, *margins(parts, _draws(rng, resamples)))


def within_intervals(
    methods: Sequence[Cells], rng: np.random.Generator | Draws, resamples: int = RESAMPLES
) -> list[Interval]:
    """Intervals of several means on the same demonstrations, free of what these share.

    A long or erratic demonstration raises the distance of every method alike. That widens the
    interval of each mean, but says nothing of their order. It is taken out as in within-subject
    designs (Cousineau 2005, Tutor. Quant. Methods Psychol. 1, 42; Morey 2008, ibid. 4, 61): from
    every method the mean over the M methods is subtracted, and what is left is scaled by
    sqrt(M / (M - 1)). These intervals compare methods with each other; they do not bound a mean.
    Only starts that all of them have count for the width.
    """
    number = len(methods)
    if number < 2:
        return [Interval.without_ends(data.mean, ONE_METHOD) for data in methods]
    tables = [data.deviations for data in shared_starts(methods)]
    if tables[0].shape[1] < 2:
        return [Interval.without_ends(data.mean, ONE_DEMO) for data in methods]
    found, draws = [], _draws(rng, resamples)
    scale = math.sqrt(number / (number - 1))
    for one, data in enumerate(methods):
        parts = [
            Part(scale * ((other == one) - 1.0 / number) * table, seeds=other)
            for other, table in enumerate(tables)
        ]
        found.append(_around(data.mean, *margins(parts, draws)))
    return found


def covers(*methods: Cells) -> str:
    """What the interval of a statistic of these methods speaks of (recordings left out)."""
    if min(len(data.sums) for data in methods) > 1:
        return TRAINING
    return NETWORK_ONLY if len(methods) == 1 else NETWORKS_ONLY


def shared_starts(methods: Sequence[Cells]) -> list[Cells]:
    """The methods on the starts that all of them have, every start weighing the same."""
    chosen = np.logical_and.reduce([data.starts for data in methods])
    return [data.of(chosen).even for data in methods]


def _draws(rng: np.random.Generator | Draws, resamples: int) -> Draws:
    return rng if isinstance(rng, Draws) else Draws.by(rng, resamples)


def _around(
    estimate: float, below: Floats, above: Floats, least: float = -math.inf, most: float = math.inf
) -> Interval:
    low, high = max(estimate - float(below), least), min(estimate + float(above), most)
    return Interval(float(estimate), low, high)
