"""What distances and differences come to when nothing differs.

If a simulator is perfect, the recording of a start is one more rollout of it: any of the R + 1
episodes from that start might as well have been the recorded one. So the null of any statistic is
found by exchanging, start by start, the recording with one of the episodes from there. That is an
exact permutation test: a perfect simulator falls inside 95 % of its null in 95 % of experiments,
whatever starts have in common and however values are distributed (checked in
``tests/algos/evaluation/test_verdict.py``). Who acts by a fixed rule in a world without chance does
the same from a start however often it is let go: such copies are one rollout, and counting them
would make the null too narrow. What recordings against recordings give, drawn from each other
without regard to their starts, is :func:`animarl_algos.evaluation.distances.null_distances`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.distances import wasserstein_weighted, weighted_distances
from animarl_algos.evaluation.statistics import UNDEFINED, Interval, percentile_interval
from animarl_envs.errors import InputError

Floats = NDArray[np.float64]

EXCHANGES = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class Tested:
    """A statistic that is zero where nothing differs, beside its null.

    ``null`` is the null's 95 % quantile and ``p`` the share of the null, the value included, that
    is at least as large.
    """

    value: float
    null: float
    p: float

    @property
    def inside(self) -> bool:
        """Whether chance alone gives as much in more than one case of twenty."""
        return not self.p <= 1 - LEVEL


@dataclass(frozen=True)
class NullDistances:
    """What both distances come to when nothing differs: mean and central 95 % of the exchanges.

    ``kde_p`` and ``wasserstein_p`` are the share of exchanges, the truth included, that give at
    least what was found.
    """

    kde: Interval = UNDEFINED
    wasserstein: Interval = UNDEFINED
    kde_p: float = math.nan
    wasserstein_p: float = math.nan


@dataclass(frozen=True, eq=False)
class Exchanges:
    """Which episode of every start is called the recorded one.

    Both are ``(1 + exchanges, episodes)`` of zeros and ones; the first row is the truth. Episodes
    are the recordings in their order, then the rollouts in theirs. Recordings that no rollout
    started from are in neither, nor are copies of a rollout.
    """

    recorded: Floats
    simulated: Floats

    @classmethod
    def draw(
        cls,
        demo: ArrayLike,
        starts: int,
        rng: np.random.Generator,
        exchanges: int = EXCHANGES,
        *,
        copies: ArrayLike | None = None,
    ) -> Exchanges:
        """Exchanges for rollouts from the starts ``demo`` ``(rollouts,)``.

        ``copies`` ``(rollouts,)`` marks those that repeat an earlier one, see
        :attr:`~animarl_algos.evaluation.rollouts.Rollouts.copies`; by default none does.

        Raises
        ------
        InputError
            If there is no rollout, or a start is none of the recordings.
        """
        demo = np.asarray(demo)
        if len(demo) == 0 or demo.min() < 0 or demo.max() >= starts:
            raise InputError(f"rollouts must start from recordings 0 to {starts - 1}")
        start = np.concatenate([np.arange(starts), demo])
        recorded, simulated = np.zeros((2, 1 + exchanges, len(start)))
        rows = np.arange(1 + exchanges)
        counts = np.ones(len(start), dtype=bool)
        if copies is not None:
            counts[starts:] = ~np.asarray(copies)
        for one in np.unique(demo):
            members = np.flatnonzero((start == one) & counts)  # the recording is the first
            chosen = rng.integers(len(members), size=1 + exchanges)
            chosen[0] = 0
            simulated[:, members] = 1.0
            recorded[rows, members[chosen]] = 1.0
            simulated[rows, members[chosen]] = 0.0
        return cls(recorded, simulated)

    def difference(self, values: ArrayLike) -> Tested:
        """Absolute difference of the means of rollouts and recordings; ``(episodes,)`` values."""
        values = np.asarray(values, dtype=np.float64)
        means = [side @ values / side.sum(axis=1) for side in (self.simulated, self.recorded)]
        return _tested(np.abs(means[0] - means[1]))

    def wasserstein(self, values: ArrayLike) -> Tested:
        """Wasserstein-1 distance of rollouts and recordings, in the values' unit."""
        values = np.asarray(values, dtype=np.float64)
        return _tested(wasserstein_weighted(values, self.simulated, values, self.recorded))

    def distances(self, values: ArrayLike) -> NullDistances:
        """Null of the kernel-density and the Wasserstein distance.

        ``values`` ``(episodes,)`` may be NaN where an episode does not count.
        """
        values = np.asarray(values, dtype=np.float64)
        counts = np.isfinite(values)
        sides = [side[:, counts] for side in (self.simulated, self.recorded)]
        if not counts.any() or min(side[0].sum() for side in sides) == 0:
            return NullDistances()
        known = values[counts]
        intervals, shares = [], []
        for drawn in weighted_distances(known, sides[0], known, sides[1]):
            null = drawn[1:][np.isfinite(drawn[1:])]
            mean = float(null.mean()) if len(null) else math.nan
            intervals.append(percentile_interval(mean, drawn[1:]))
            shares.append(_tested(np.concatenate([drawn[:1], null])).p)
        return NullDistances(intervals[0], intervals[1], shares[0], shares[1])

    def chi_squared(self, category: ArrayLike) -> Tested:
        """Pearson's statistic of categories by recorded and simulated, however small the counts."""
        category = np.asarray(category)
        sides = (self.recorded, self.simulated)
        sizes = [side.sum(axis=1) for side in sides]
        total = np.zeros(len(self.recorded))
        for one in np.unique(category):
            counts = [side @ (category == one) for side in sides]
            share = sum(counts) / sum(sizes)
            for count, size in zip(counts, sizes):
                with np.errstate(invalid="ignore", divide="ignore"):
                    total += np.where(share > 0, (count - size * share) ** 2 / (size * share), 0.0)
        return _tested(total)


def _tested(drawn: Floats) -> Tested:
    """The first is the value, all others its null; differences of rounding do not count."""
    value, null = float(drawn[0]), drawn[1:]
    at_least = int(np.count_nonzero(null >= value * (1 - 1e-9) - 1e-12))
    quantile = float(np.quantile(null, LEVEL)) if len(null) else float("nan")
    return Tested(value, quantile, (1 + at_least) / (1 + len(null)))
