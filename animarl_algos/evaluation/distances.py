"""Distances between two distributions of a metric, their null references and their intervals.

The kernel-density distance is the paper's measure of similarity (Statistical analysis). It is
biased upwards, the more so the smaller the samples, so every value comes with what recordings
compared with recordings give at the same sample sizes, and with the Wasserstein distance, which is
less biased and has the metric's unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.statistics import (
    NO_VALUE,
    ONE_DEMO,
    UNDEFINED,
    Interval,
    draw_weights,
    percentile_interval,
)

Floats = NDArray[np.float64]

KDE_GRID = 512
KDE_MARGIN = 4.0  # the grid reaches this many bandwidths beyond the values
KDE_FLOOR = 0.01  # no bandwidth is smaller than this share of the pooled range
DISTANCE_RESAMPLES = 1000


@dataclass(frozen=True)
class KdeRule:
    """The grid and the smallest bandwidth, fixed once for all samples that are compared.

    The bandwidth of a sample is Scott's, ``n^(-1/5)`` times its standard deviation, the default of
    ``scipy.stats.gaussian_kde``, but never less than ``floor``, so that values without any
    variance (every episode timing out) are a narrow peak instead of an error.
    """

    start: float
    step: float
    floor: float

    @property
    def grid(self) -> Floats:
        return np.asarray(self.start + self.step * np.arange(KDE_GRID))


def kde_rule(*samples: ArrayLike) -> KdeRule | None:
    """The rule for these samples together; ``None`` if all their values are equal."""
    pooled = np.concatenate([np.asarray(sample, dtype=np.float64) for sample in samples])
    spread = float(np.ptp(pooled))
    if spread <= 1e-9 * max(1.0, float(np.abs(pooled).max())):
        return None
    floor = KDE_FLOOR * spread
    widest = max(_scott(np.asarray(sample, dtype=np.float64), floor) for sample in samples)
    low, high = pooled.min() - KDE_MARGIN * widest, pooled.max() + KDE_MARGIN * widest
    return KdeRule(float(low), float((high - low) / (KDE_GRID - 1)), floor)


def kde_distance(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """L1 distance between two Gaussian kernel density estimates, from 0 (equal) to 2 (disjoint).

    It is biased upwards: two samples of 10 and 50 values from one normal distribution differ by
    about 0.39. Read it beside :func:`null_distances`.
    """
    from scipy.stats import gaussian_kde

    first, second = _sample(simulated), _sample(recorded)
    if min(len(first), len(second)) == 0:
        return math.nan
    rule = kde_rule(first, second)
    if rule is None:
        return 0.0
    densities = []
    for sample in (first, second):
        if _scott(sample, rule.floor) > rule.floor:
            densities.append(gaussian_kde(sample)(rule.grid))
        else:  # hardly any variance: the same sum of Gaussians, of the smallest width
            z = (rule.grid[:, None] - sample) / rule.floor
            densities.append(np.exp(-0.5 * z**2).mean(axis=1) / (rule.floor * math.sqrt(math.tau)))
    return float(np.abs(densities[0] - densities[1]).sum() * rule.step)


def kde_floor(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """The smallest bandwidth, in the values' unit, where it acts on either sample; else NaN.

    It acts where values hardly vary, as when nearly all episodes time out, and the kernel-density
    distance then depends on it.
    """
    first, second = _sample(simulated), _sample(recorded)
    rule = kde_rule(first, second) if min(len(first), len(second)) else None
    if rule is None or min(_scott(sample, rule.floor) for sample in (first, second)) > rule.floor:
        return math.nan
    return rule.floor


def wasserstein(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """Wasserstein-1 distance in the metric's own unit: mean shift needed to make them equal."""
    first, second = _sample(simulated), _sample(recorded)
    if min(len(first), len(second)) == 0:
        return math.nan
    one = np.ones((1, len(first))), np.ones((1, len(second)))
    return float(wasserstein_weighted(first, one[0], second, one[1])[0])


def wasserstein_weighted(a: Floats, first: Floats, b: Floats, second: Floats) -> Floats:
    """Wasserstein-1 between values ``a`` and ``b`` under weightings ``(resamples, values)``."""
    points = np.unique(np.concatenate([a, b]))

    def cdf(values: Floats, weights: Floats) -> Floats:
        order = np.argsort(values, kind="stable")
        below = np.searchsorted(values[order], points[:-1], side="right")
        sums = np.zeros((len(weights), len(values) + 1))
        np.cumsum(weights[:, order], axis=1, out=sums[:, 1:])
        return np.asarray(sums[:, below] / sums[:, -1:])

    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.abs(cdf(a, first) - cdf(b, second)) @ np.diff(points))


def kde_weighted(rule: KdeRule, support: Floats, weights: Floats) -> Floats:
    """Densities ``(resamples, grid)`` of weightings ``(resamples, values)`` of ``support``.

    Values are shared out between their two neighbouring grid points and smoothed by a Fourier
    transform, which agrees with the exact estimate to a few parts in a thousand of its L1 norm.
    """
    return _on_grid(rule, _spectra(rule, support, weights))


def _spectra(rule: KdeRule, support: Floats, weights: Floats) -> NDArray[np.complex128]:
    """Fourier transforms of the densities."""
    from scipy.fft import rfft
    from scipy.sparse import csr_array

    number = weights.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = weights @ support / number
        variance = (weights @ support**2 / number - mean**2) * number / (number - 1)
        width = np.sqrt(np.maximum(variance, 0.0)) * number**-0.2
    width = np.where(np.isfinite(width), np.maximum(width, rule.floor), rule.floor)
    place = (support - rule.start) / rule.step
    left = np.clip(np.floor(place).astype(int), 0, KDE_GRID - 2)
    share = place - left
    rows = np.arange(len(support))
    binning = csr_array(
        (
            np.concatenate([1.0 - share, share]),
            (np.concatenate([left, left + 1]), np.concatenate([rows, rows])),
        ),
        shape=(KDE_GRID, len(support)),
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        mass = (binning @ weights.T).T / number[:, None]
    frequency = 2.0 * np.pi * np.fft.rfftfreq(2 * KDE_GRID)
    smooth = np.exp(-0.5 * np.square(width[:, None] / rule.step * frequency))
    return np.asarray(rfft(mass, n=2 * KDE_GRID, axis=1) * smooth)


def _on_grid(rule: KdeRule, spectra: NDArray[np.complex128]) -> Floats:
    from scipy.fft import irfft

    return np.asarray(irfft(spectra, n=2 * KDE_GRID, axis=1)[:, :KDE_GRID] / rule.step)


@dataclass(frozen=True)
class Distances:
    """Kernel-density and Wasserstein distance, each with an interval or a null range."""

    kde: Interval
    wasserstein: Interval


def null_distances(
    recorded: ArrayLike,
    num_simulated: int,
    rng: np.random.Generator,
    resamples: int = DISTANCE_RESAMPLES,
    num_recorded: int | None = None,
) -> Distances:
    """What the distances come to when nothing differs: recordings against recordings.

    Two samples, of ``num_simulated`` and ``num_recorded`` values (by default as many as there
    are), are drawn with replacement from the recorded values. ``estimate`` is the mean of the null
    distribution, ``low`` and ``high`` hold its central 95 %.
    """
    support = _sample(recorded)
    if len(support) == 0 or num_simulated < 1:
        return Distances(UNDEFINED, UNDEFINED)
    num_recorded = len(support) if num_recorded is None else num_recorded
    even = np.full(len(support), 1.0 / len(support))
    first = rng.multinomial(num_simulated, even, size=resamples).astype(np.float64)
    second = rng.multinomial(num_recorded, even, size=resamples).astype(np.float64)
    kde, distance = weighted_distances(support, first, support, second)
    return Distances(
        percentile_interval(float(np.mean(kde)), kde),
        percentile_interval(float(np.mean(distance)), distance),
    )


def bootstrap_distances(
    simulated: ArrayLike,
    recorded: ArrayLike,
    seed: ArrayLike,
    demo: ArrayLike,
    rng: np.random.Generator,
    resamples: int = DISTANCE_RESAMPLES,
) -> Distances:
    """Distances of rollouts to recordings with hierarchical bootstrap intervals.

    Parameters
    ----------
    simulated, seed, demo
        ``(rollouts,)``: value, training seed and demonstration of each; NaN does not count.
    recorded
        ``(demos,)``, NaN where a recording does not count.

    Notes
    -----
    The kernel-density distance is biased upwards, and a resample repeats values, so its interval
    may lie above the estimate: it shows spread, the null reference shows the bias.
    """
    simulated = np.asarray(simulated, dtype=np.float64)
    recorded = np.asarray(recorded, dtype=np.float64)
    counts, present = np.isfinite(simulated), np.isfinite(recorded)
    estimates = kde_distance(simulated, recorded), wasserstein(simulated, recorded)
    if not counts.any() or not present.any() or len(recorded) < 2:
        reason = ONE_DEMO if counts.any() and present.any() else NO_VALUE
        return Distances(*(Interval.without_ends(one, reason) for one in estimates))
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    demo_weights = draw_weights(rng, len(recorded), resamples)
    seed_weights = draw_weights(rng, len(seeds), resamples)
    first = seed_weights[:, row.ravel()[counts]] * demo_weights[:, np.asarray(demo)[counts]]
    kde, distance = weighted_distances(
        simulated[counts], first, recorded[present], demo_weights[:, present]
    )
    return Distances(
        percentile_interval(estimates[0], kde), percentile_interval(estimates[1], distance)
    )


def weighted_distances(
    a: Floats, first: Floats, b: Floats, second: Floats
) -> tuple[Floats, Floats]:
    """Both distances ``(resamples,)`` of values ``a`` and ``b``, each with its weightings."""
    distance = wasserstein_weighted(a, first, b, second)
    rule = kde_rule(a[first.any(axis=0)], b[second.any(axis=0)])
    if rule is None:
        return np.zeros(len(first)), distance
    difference = _on_grid(rule, _spectra(rule, a, first) - _spectra(rule, b, second))
    return np.abs(difference).sum(axis=1) * rule.step, distance


def _sample(values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64).ravel()
    return array[np.isfinite(array)]


def _scott(sample: Floats, floor: float) -> float:
    """Scott's bandwidth of a sample, at least ``floor``."""
    if len(sample) < 2:
        return floor
    return max(float(np.std(sample, ddof=1)) * math.pow(len(sample), -0.2), floor)
