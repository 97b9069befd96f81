"""What chance alone gives: exchanges of recordings with rollouts, and one test for all measures.

If a simulator is perfect, the recording of a start is one more rollout of it. So the null of any
statistic is found by exchanging, start by start, the recording with one of the episodes from there:
an exact permutation test. Who acts by a fixed rule in a world without chance does the same from a
start however often it is let go; such copies are one rollout.

Differences are studentised in every exchange (Chung and Romano 2013, Ann. Stat. 41, 484): where few
rollouts are far off, as those of animals that freeze, the recordings alone have a small error, and
those of an exchange a large one. Of several measures the statistic is the largest such difference
(maxT; Westfall and Young 1993, *Resampling-Based Multiple Testing*, algorithm 2.5, single step). So
a perfect simulator has no measure below .05 in 95 % of experiments, however many measures there are
and however they depend on each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.statistics import Floats, Ints
from animarl_envs.errors import InputError

EXCHANGES = 1000
LEVEL = 0.05
FLOOR = 0.1  # of the mean variance over exchanges: no standard error is much smaller


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
        return not self.p <= LEVEL

    @classmethod
    def of(cls, drawn: Floats) -> Tested:
        """The first is the value, all others its null; differences of rounding do not count."""
        value, null = float(drawn[0]), drawn[1:]
        at_least = int(np.count_nonzero(null >= value * (1 - 1e-9) - 1e-12))
        quantile = float(np.quantile(null, 1 - LEVEL)) if len(null) else math.nan
        return cls(value, quantile, (1 + at_least) / (1 + len(null)))


@dataclass(frozen=True, eq=False)
class Exchanges:
    """Which episode of every start is called the recorded one.

    Both are ``(1 + exchanges, episodes)`` of zeros and ones; the first row is the truth. Episodes
    are the recordings in their order, then the rollouts in theirs, without those that do not count.
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

    def chi_squared(self, category: ArrayLike) -> Tested:
        """Pearson's statistic of categories by recorded and simulated, however small the counts."""
        category = np.asarray(category)
        sides = self.simulated, self.recorded
        sizes = [side.sum(axis=1) for side in sides]
        total = np.zeros(len(self.recorded))
        for one in np.unique(category):
            counts = [side @ (category == one) for side in sides]
            share = sum(counts) / sum(sizes)
            for count, size in zip(counts, sizes):
                with np.errstate(invalid="ignore", divide="ignore"):
                    total += np.where(share > 0, (count - size * share) ** 2 / (size * share), 0.0)
        return Tested.of(total)


@dataclass(frozen=True)
class ExchangeTest:
    """What the joint test found, all ``(measures,)`` but the ``level`` at which measures differ.

    Means of recordings and of rollouts, where every start counts alike; their studentised
    difference in standard deviations of its null (``statistic``); p corrected for the number of
    measures (NaN where one is undefined); and how far apart means of this
    spread may be by chance over all measures together (``null``).
    """

    recorded: Floats
    simulated: Floats
    statistic: Floats
    adjusted_p: Floats
    null: Floats
    level: float = LEVEL

    @property
    def p(self) -> float:
        """Of the global test: the least adjusted p."""
        return least_p(self.adjusted_p)

    @property
    def differs(self) -> NDArray[np.bool_]:
        """Which measures differ at the level of all measures together."""
        return np.asarray(self.adjusted_p <= self.level)


def least_p(p: Floats) -> float:
    """The least of some p, NaN where none is defined."""
    return float(np.nanmin(p)) if np.isfinite(p).any() else math.nan


def exchange_test(
    values: Floats,
    exchanges: Exchanges,
    *,
    level: float = LEVEL,
    start: Ints | None = None,
    group: Ints | None = None,
    rng: np.random.Generator | None = None,
) -> ExchangeTest:
    """Test all measures together.

    Parameters
    ----------
    values
        ``(episodes, measures)``: recordings in their order, then rollouts in theirs. NaN where a
        measure is undefined in an episode, which then does not count.
    exchanges, level
        The null, and the level at which measures are said to differ.
    start, group, rng
        Where several recordings are of one animal: ``(episodes,)`` start of each episode, and
        ``(starts,)`` the animal of each. The null then turns the sign of all differences of an
        animal together (a sign-flip test), as what its recordings have in common is no evidence
        beyond one animal.
    """
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [
            side @ filled / (side @ known) for side in (exchanges.recorded, exchanges.simulated)
        ]
        gap = means[1] - means[0]
        scale = _standard_errors(filled, known, exchanges, means)
        if start is not None and group is not None and rng is not None:
            gap, scale = _flipped_gaps(values, exchanges, start, group, rng), np.ones_like(gap)
        # Differences of rounding only are none.
        tiny = 1e-9 * np.maximum(np.nanmax(np.abs(filled), axis=0), 1e-300)
        some = np.isfinite(gap[1:]).any(axis=0)  # episodes may be too short for a measure
        varies = np.nanstd(np.where(some, gap[1:], 0.0), axis=0) > tiny
        studentised = gap / np.where(varies, scale, 1.0)
        spread = np.nanstd(np.where(varies, studentised[1:], 0.0), axis=0)
        scaled = np.where(varies, studentised / np.where(varies, spread, 1.0), np.nan)
    size = np.abs(scaled)
    defined = np.isfinite(size[0])
    adjusted, null = np.full((2, values.shape[1]), np.nan)
    if defined.any():
        largest = np.nanmax(size[1:, defined], axis=1)
        reached = largest[:, None] >= size[0, defined] * (1 - 1e-9)
        adjusted[defined] = (1 + reached.sum(axis=0)) / (1 + len(largest))
        null = np.where(defined, scale[0] * spread * np.quantile(largest, 1 - level), np.nan)
    return ExchangeTest(means[0][0], means[1][0], scaled[0], adjusted, null, level)


def _standard_errors(
    filled: Floats, known: NDArray[np.bool_], exchanges: Exchanges, means: list[Floats]
) -> Floats:
    """Standard errors of the difference of both means, ``(1 + exchanges, measures)``, after Welch.

    A share (``FLOOR``) of the mean variance is added, as the values of few recordings may be alike.
    """
    square = np.zeros(means[0].shape)
    for side, mean in zip((exchanges.recorded, exchanges.simulated), means):
        number = side @ known
        square = square + np.maximum(side @ filled**2 / number - mean**2, 0.0) / number
    return np.asarray(np.sqrt(square + FLOOR * np.nan_to_num(square[1:]).mean(axis=0)))


def _flipped_gaps(
    values: Floats, exchanges: Exchanges, start: Ints, group: Ints, rng: np.random.Generator
) -> Floats:
    """Return the mean difference, then those with the signs of whole animals turned."""
    starts = len(group)
    known = np.isfinite(values) & (exchanges.simulated[0] > 0)[:, None]
    owner = np.zeros((starts, len(values)))
    owner[start, np.arange(len(values))] = 1.0
    rollouts = owner @ np.where(known, values, 0.0) / (owner @ known)
    apart = rollouts - np.where(exchanges.recorded[0, :starts, None] > 0, values[:starts], np.nan)
    there = np.isfinite(apart)
    signs = rng.choice([-1.0, 1.0], size=(len(exchanges.recorded), int(group.max()) + 1))
    signs[0] = 1.0
    return np.asarray(signs[:, group] @ np.where(there, apart, 0.0) / there.sum(axis=0))
