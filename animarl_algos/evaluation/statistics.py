"""Statistics of rollouts against recordings: arrays and a seeded generator in, numbers out.

What is resampled. Rollouts are nested: several from each recorded start, several starts, several
training seeds. Repetitions from one start are never treated as independent; demonstrations and
seeds are resampled, both with replacement and independently of each other (the pigeonhole bootstrap
of a crossed design: Owen 2007, Ann. Appl. Stat. 1, 386). What is compared on the same
demonstrations shares their resample, which is what makes the bootstrap paired. With a single
seed an interval speaks of demonstrations only, for the one network that was trained.

With few seeds a percentile interval is too short where seeds differ much; how much is measured in
``tests/test_statistics.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.errors import InputError

RESAMPLES = 10_000
CONFIDENCE = 0.95

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """An estimate with its percentile interval; NaN where it is not defined."""

    estimate: float
    low: float
    high: float

    @property
    def excludes_zero(self) -> bool:
        return self.low > 0 or self.high < 0

    def overlaps(self, other: Interval) -> bool:
        """Whether the two intervals share a value; undefined intervals overlap everything."""
        return not (self.high < other.low or other.high < self.low)


UNDEFINED = Interval(math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Cells:
    """Sums and counts of one metric per training seed and demonstration, each ``(seeds, demos)``.

    The mean over any resample of seeds and demonstrations is a ratio of the two.
    """

    sums: Floats
    counts: Floats

    def __post_init__(self) -> None:
        if self.sums.ndim != 2 or self.sums.shape != self.counts.shape:
            raise InputError(
                f"sums {self.sums.shape} and counts {self.counts.shape} must both be (seeds, demos)"
            )

    @property
    def mean(self) -> float:
        total = self.counts.sum()
        return float(self.sums.sum() / total) if total else math.nan

    @property
    def cell_means(self) -> Floats:
        """Mean per seed and demonstration, NaN where nothing counts."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.sums / self.counts)


def cells(
    values: ArrayLike, seed: ArrayLike, demo: ArrayLike, num_demos: int, counts: ArrayLike = True
) -> Cells:
    """Gather one value per rollout into cells of seed and demonstration.

    Parameters
    ----------
    values, seed, demo
        ``(rollouts,)``: the metric, the training seed, and the demonstration's index below
        ``num_demos``.
    counts
        ``(rollouts,)`` bool, which rollouts count; NaN values never do.
    """
    values = np.asarray(values, dtype=np.float64)
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    chosen = np.isfinite(values) & np.asarray(counts)
    place = (row.ravel()[chosen], np.asarray(demo)[chosen])
    sums, number = np.zeros((len(seeds), num_demos)), np.zeros((len(seeds), num_demos))
    np.add.at(sums, place, values[chosen])
    np.add.at(number, place, 1.0)
    return Cells(sums, number)


# -- resampling -----------------------------------------------------------------------------------


def draw_weights(
    rng: np.random.Generator, count: int, resamples: int = RESAMPLES
) -> NDArray[np.float64]:
    """How often each of ``count`` units is drawn, ``(resamples, count)``; rows sum to ``count``."""
    if count < 1:
        raise InputError("there is nothing to resample: give at least one unit")
    return rng.multinomial(count, np.full(count, 1.0 / count), size=resamples).astype(np.float64)


def resampled_means(data: Cells, seed_weights: Floats, demo_weights: Floats) -> Floats:
    """Mean of each resample, ``(resamples,)``; NaN where nothing that counts was drawn.

    ``seed_weights`` is ``(resamples, seeds)`` and ``demo_weights`` ``(resamples, demos)``.
    """

    def weighted(table: Floats) -> Floats:
        return np.asarray(np.einsum("rd,rd->r", seed_weights @ table, demo_weights))

    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(weighted(data.sums) / weighted(data.counts))


def percentile_interval(
    estimate: float, resampled: Floats, confidence: float = CONFIDENCE
) -> Interval:
    """Percentile interval of resampled estimates.

    It is undefined (NaN) when more than one resample in twenty has no value.
    """
    defined = resampled[np.isfinite(resampled)]
    if not math.isfinite(estimate) or len(defined) < 0.95 * len(resampled):
        return Interval(estimate, math.nan, math.nan)
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(defined, [tail, 100.0 - tail])
    return Interval(float(estimate), float(low), float(high))


def bootstrap_mean(data: Cells, rng: np.random.Generator, resamples: int = RESAMPLES) -> Interval:
    """Mean over rollouts with its hierarchical bootstrap interval."""
    num_seeds, num_demos = data.sums.shape
    seed_weights = draw_weights(rng, num_seeds, resamples)
    demo_weights = draw_weights(rng, num_demos, resamples)
    return percentile_interval(data.mean, resampled_means(data, seed_weights, demo_weights))


def bootstrap_difference(
    first: Cells,
    second: Cells,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    *,
    same_seeds: bool = False,
) -> Interval:
    """``mean(first) - mean(second)`` on the same demonstrations, paired by demonstration.

    Parameters
    ----------
    same_seeds
        Whether seed ``i`` of both is one and the same trained network (asked two questions), so
        that the seeds' resample is shared as well. Recordings are cells with one row.
    """
    if first.sums.shape[1] != second.sums.shape[1]:
        raise InputError("paired samples need the same demonstrations")
    demo_weights = draw_weights(rng, first.sums.shape[1], resamples)
    first_seeds = draw_weights(rng, len(first.sums), resamples)
    second_seeds = first_seeds if same_seeds else draw_weights(rng, len(second.sums), resamples)
    resampled = resampled_means(first, first_seeds, demo_weights) - resampled_means(
        second, second_seeds, demo_weights
    )
    return percentile_interval(first.mean - second.mean, resampled)


def within_demo_intervals(
    estimates: ArrayLike, resampled: ArrayLike, confidence: float = CONFIDENCE
) -> list[Interval]:
    """Intervals of several means on the same demonstrations, free of what these share.

    A long or erratic demonstration raises the distance of every method alike. That widens the
    interval of each mean, but says nothing of their order. It is taken out as in within-subject
    designs (Cousineau 2005, Tutor. Quant. Methods Psychol. 1, 42; Morey 2008, ibid. 4, 61): from
    every resample the mean over the M methods is subtracted, and what is left is scaled by
    sqrt(M / (M - 1)). These intervals compare methods with each other; they do not bound a mean.

    Parameters
    ----------
    estimates
        ``(M,)``, one mean per method.
    resampled
        ``(M, resamples)``, means of the same resamples of demonstrations.

    Returns
    -------
    One interval per method around its estimate; undefined (NaN) for a single method.
    """
    means, draws = np.asarray(estimates, dtype=np.float64), np.asarray(resampled, dtype=np.float64)
    if means.ndim != 1 or draws.ndim != 2 or len(means) != len(draws):
        raise InputError(
            f"estimates {means.shape} and resampled {draws.shape} must be (methods,) and "
            "(methods, resamples)"
        )
    number = len(means)
    if number < 2:
        return [Interval(float(mean), math.nan, math.nan) for mean in means]
    own = (draws - draws.mean(axis=0)) - (means - means.mean())[:, None]
    scaled = means[:, None] + math.sqrt(number / (number - 1)) * own
    return [percentile_interval(float(mean), row, confidence) for mean, row in zip(means, scaled)]


# -- one-way ANOVA ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Anova:
    """One-way F statistic with its permutation p value; ``unit`` says what was permuted."""

    f: float
    p: float
    unit: str


def f_statistic(groups: Floats) -> Floats:
    """One-way F of ``(..., groups, units)``: variance between groups over that within them."""
    num_groups, units = groups.shape[-2:]
    means = groups.mean(axis=-1)
    between = units * np.square(means - means.mean(axis=-1, keepdims=True)).sum(axis=-1)
    within = np.square(groups - means[..., None]).sum(axis=(-2, -1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((between / (num_groups - 1)) / (within / (num_groups * (units - 1))))


def permutation_anova(
    groups: ArrayLike,
    rng: np.random.Generator,
    permutations: int = RESAMPLES,
    *,
    paired: bool,
    unit: str = "unit",
) -> Anova:
    """One-way ANOVA whose null distribution comes from exchanging group labels.

    Parameters
    ----------
    groups
        ``(groups, units)``. ``paired=True``: unit ``i`` is the same in every group (one
        demonstration), and labels are exchanged within it only. ``paired=False``: all units are
        independent (training seeds), and are dealt afresh.

    Returns
    -------
    The p value counts the observed order among the permutations, ``(1 + #{F* >= F}) / (1 + n)``,
    so it is never zero and is valid for any number of permutations.
    """
    table = np.asarray(groups, dtype=np.float64)
    if table.ndim != 2 or min(table.shape) < 2 or not np.isfinite(table).all():
        raise InputError("an ANOVA needs at least two groups of two finite values each")
    if np.ptp(table) == 0:
        return Anova(0.0, 1.0, unit)
    axis = 0 if paired else 1
    source = table if paired else table.reshape(1, -1)
    observed = float(f_statistic(table))
    at_least, left = 0, permutations
    while left:
        batch = min(left, max(1, 2_000_000 // table.size))
        shuffled = rng.permuted(np.broadcast_to(source, (batch, *source.shape)), axis=1 + axis)
        null = f_statistic(shuffled.reshape(batch, *table.shape))
        at_least += int(np.count_nonzero(null >= observed * (1 - 1e-12)))
        left -= batch
    return Anova(observed, (1 + at_least) / (1 + permutations), unit)
