"""One test for all measures of a verdict: does anything differ, and what?

If a simulator is perfect, the recording of a start is one more rollout of it
(:mod:`animarl_algos.evaluation.null`). Exchanging them gives the joint null of all measures at
once. The test statistic is the largest standardised difference over measures (maxT; Westfall and
Young 1993, *Resampling-Based Multiple Testing*, algorithm 2.5, single step). A measure's adjusted p
is the share of exchanges whose *largest* statistic reaches the one found for this measure. So a
perfect simulator has no measure below .05 in 95 % of experiments, however many measures there are
and however they depend on each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.null import Exchanges

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEVEL = 0.05


@dataclass(frozen=True)
class ExchangeTest:
    """What the joint test found.

    Parameters
    ----------
    recorded, simulated
        ``(measures,)`` means of recordings and of rollouts; every start counts alike.
    statistic
        ``(measures,)`` difference of both means, in standard deviations of the null.
    adjusted_p
        ``(measures,)``, corrected for the number of measures; NaN where a measure is undefined.
    null
        ``(measures,)`` how far apart both means may be by chance, over all measures together.
    p
        Of the global test: the least adjusted p.
    level
        At which measures differ.
    """

    recorded: Floats
    simulated: Floats
    statistic: Floats
    adjusted_p: Floats
    null: Floats
    p: float
    level: float = LEVEL

    @property
    def differs(self) -> NDArray[np.bool_]:
        """Which measures differ at the level of all measures together."""
        return np.asarray(self.adjusted_p <= self.level)


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
    exchanges
        Which episode of a start is called the recorded one; the first row is the truth.
    level
        At which measures are said to differ.
    start, group, rng
        Where several recordings are of one animal: ``(episodes,)`` start of each episode, and
        ``(starts,)`` the animal of each. What recordings of one animal have in common is no
        evidence beyond one animal, so the null then turns the sign of all differences of an animal
        together (a sign-flip test), by draws from ``rng``.
    """
    values = np.asarray(values, dtype=np.float64)
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [
            side @ filled / (side @ known) for side in (exchanges.recorded, exchanges.simulated)
        ]
        gap = means[1] - means[0]
        if start is not None and group is not None and rng is not None:
            gap = _flipped_gaps(values, exchanges, start, group, rng)
        spread = np.nanstd(gap[1:], axis=0)
        # Differences of rounding only are none.
        tiny = 1e-9 * np.maximum(np.nanmax(np.abs(filled), axis=0), 1e-300)
        scaled = np.where(spread > tiny, gap / np.where(spread > tiny, spread, 1.0), np.nan)
    size = np.abs(scaled)
    defined = np.isfinite(size[0])
    adjusted, null = np.full((2, values.shape[1]), np.nan)
    if defined.any():
        largest = np.nanmax(size[1:, defined], axis=1)
        reached = largest[:, None] >= size[0, defined] * (1 - 1e-9)
        adjusted[defined] = (1 + reached.sum(axis=0)) / (1 + len(largest))
        null = np.where(defined, spread * np.quantile(largest, 1 - level), np.nan)
    p = float(np.nanmin(adjusted)) if defined.any() else float("nan")
    return ExchangeTest(means[0][0], means[1][0], scaled[0], adjusted, null, p, level)


def _flipped_gaps(
    values: Floats, exchanges: Exchanges, start: Ints, group: Ints, rng: np.random.Generator
) -> Floats:
    """Return the mean difference, then those with the signs of whole animals turned."""
    starts = len(group)
    counted = exchanges.simulated[0] > 0
    known = np.isfinite(values) & counted[:, None]
    owner = np.zeros((starts, len(values)))
    owner[start, np.arange(len(values))] = 1.0
    rollouts = owner @ np.where(known, values, 0.0) / (owner @ known)
    apart = rollouts - np.where(exchanges.recorded[0, :starts, None] > 0, values[:starts], np.nan)
    there = np.isfinite(apart)
    signs = rng.choice([-1.0, 1.0], size=(len(exchanges.recorded), int(group.max()) + 1))
    signs[0] = 1.0
    return np.asarray(signs[:, group] @ np.where(there, apart, 0.0) / there.sum(axis=0))
