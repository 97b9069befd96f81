"""How far distributions of a metric are apart: kernel density, Wasserstein, energy score.

The kernel-density distance is the paper's measure of similarity (Statistical analysis). It is
biased upwards, so every value comes with what a perfect simulator gives. The energy score (Gneiting
and Raftery 2007, J. Am. Stat. Assoc. 102, 359) compares the rollouts X, X' of a start with the
recording y from there: E|X - y| - E|X - X'| / 2 is smallest on average for the distribution that y
is drawn from.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.statistics import (
    NO_VALUE,
    ONE_DEMO,
    Cells,
    Floats,
    Interval,
    draw_weights,
    percentile_interval,
    single_cells,
)

KDE_GRID = 512
KDE_MARGIN = 4.0  # the grid reaches this many bandwidths beyond the values
KDE_FLOOR = 0.01  # no bandwidth is smaller than this share of the pooled range
DISTANCE_RESAMPLES = 1000
FEW_ROLLOUTS = "fewer than two rollouts a start"


def kde_grid(*samples: ArrayLike) -> tuple[Floats, list[float]] | None:
    """Return points ``(KDE_GRID,)`` over all samples and their bandwidths; None if all is equal.

    Bandwidths are Scott's, as in ``scipy.stats.gaussian_kde``, but never less than ``KDE_FLOOR`` of
    the pooled range, so that values without any variance (every episode timing out) are a narrow
    peak.
    """
    arrays = [np.asarray(sample, dtype=np.float64) for sample in samples]
    pooled = np.concatenate(arrays)
    spread = float(np.ptp(pooled))
    if spread <= 1e-9 * max(1.0, float(np.abs(pooled).max())):
        return None
    widths = [KDE_FLOOR * spread] * len(arrays)
    for i, sample in enumerate(arrays):
        if len(sample) > 1:
            widths[i] = max(widths[i], float(np.std(sample, ddof=1)) * len(sample) ** -0.2)
    margin = KDE_MARGIN * max(widths)
    return np.linspace(pooled.min() - margin, pooled.max() + margin, KDE_GRID), widths


def densities(grid: Floats, width: float, values: Floats, weights: Floats) -> Floats:
    """Gaussian densities on a grid of weightings ``(resamples, values)``, ``(resamples, grid)``."""
    kernels = np.exp(-0.5 * ((grid - values[:, None]) / width) ** 2) / (width * math.sqrt(math.tau))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(weights @ kernels / weights.sum(axis=1, keepdims=True))


def kde_distances(a: Floats, first: Floats, b: Floats, second: Floats) -> Floats:
    """L1 distances ``(resamples,)`` of densities of ``a`` and ``b``, each with its weightings.

    Every weighting has its own bandwidth, so that exchanged samples are treated like observed ones.
    Values are shared out between their two neighbouring grid points and smoothed by a Fourier
    transform, which agrees with the exact estimate to a few parts in a thousand.
    """
    from scipy.fft import irfft

    samples = a[first.any(axis=0)], b[second.any(axis=0)]
    found = kde_grid(*samples)
    if found is None:
        return np.zeros(len(first))
    grid, floor = found[0], KDE_FLOOR * float(np.ptp(np.concatenate(samples)))
    spectra = _spectra(grid, floor, a, first) - _spectra(grid, floor, b, second)
    return np.asarray(np.abs(irfft(spectra, n=2 * KDE_GRID, axis=1)[:, :KDE_GRID]).sum(axis=1))


def _spectra(grid: Floats, floor: float, values: Floats, weights: Floats) -> NDArray[np.complex128]:
    """Fourier transforms of the densities of all weightings, times the step of the grid."""
    from scipy.fft import rfft

    step, number = grid[1] - grid[0], weights.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = weights @ values / number
        variance = (weights @ values**2 / number - mean**2) * number / (number - 1)
        width = np.sqrt(np.maximum(variance, 0.0)) * number**-0.2
        share = weights / number[:, None]
    width = np.where(np.isfinite(width), np.maximum(width, floor), floor)
    place = (values - grid[0]) / step
    left = np.clip(np.floor(place).astype(int), 0, KDE_GRID - 2)
    binned, rows = np.zeros((len(values), KDE_GRID)), np.arange(len(values))
    binned[rows, left], binned[rows, left + 1] = 1.0 - (place - left), place - left
    frequency = 2.0 * np.pi * np.fft.rfftfreq(2 * KDE_GRID)
    smooth = np.exp(-0.5 * np.square(width[:, None] / step * frequency))
    return np.asarray(rfft(share @ binned, n=2 * KDE_GRID, axis=1) * smooth)


def kde_distance(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """L1 distance between two Gaussian kernel density estimates, from 0 (equal) to 2 (disjoint).

    It is biased upwards: two samples of 10 and 50 values from one normal distribution differ by
    about 0.39.
    """
    samples = _finite(simulated), _finite(recorded)
    if not min(map(len, samples)):
        return math.nan
    found = kde_grid(*samples)
    if found is None:
        return 0.0
    grid, widths = found
    one, other = (
        densities(grid, width, sample, np.ones((1, len(sample))))
        for width, sample in zip(widths, samples, strict=True)
    )
    return float(np.abs(one - other).sum() * (grid[1] - grid[0]))


def bootstrap_kde(
    simulated: ArrayLike,
    recorded: ArrayLike,
    seed: ArrayLike,
    demo: ArrayLike,
    rng: np.random.Generator,
    resamples: int = DISTANCE_RESAMPLES,
) -> Interval:
    """Kernel-density distance with its hierarchical bootstrap interval.

    Values, training seeds and demonstrations of rollouts are ``(rollouts,)``, ``recorded`` is
    ``(demos,)``; NaN does not count. The distance is biased upwards, and a resample repeats values,
    so its interval may lie above the estimate: it shows spread, the null shows the bias.
    """
    simulated = np.asarray(simulated, dtype=np.float64)
    recorded = np.asarray(recorded, dtype=np.float64)
    counts, present = np.isfinite(simulated), np.isfinite(recorded)
    if not counts.any() or not present.any() or len(recorded) < 2:
        reason = ONE_DEMO if counts.any() and present.any() else NO_VALUE
        return Interval(kde_distance(simulated, recorded), reason=reason)
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    demo_weights, seed_weights = (
        draw_weights(rng, count, resamples) for count in (len(recorded), len(seeds))
    )
    first = seed_weights[:, row.ravel()[counts]] * demo_weights[:, np.asarray(demo)[counts]]
    second = demo_weights[:, present]
    drawn = kde_distances(simulated[counts], first, recorded[present], second)
    return percentile_interval(kde_distance(simulated, recorded), drawn)


def wasserstein(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """Wasserstein-1 distance in the metric's own unit: mean shift needed to make them equal."""
    from scipy.stats import wasserstein_distance

    samples = _finite(simulated), _finite(recorded)
    return float(wasserstein_distance(*samples)) if min(map(len, samples)) else math.nan


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


def recorded_null(
    recorded: Floats, number: int, rng: np.random.Generator, resamples: int = DISTANCE_RESAMPLES
) -> float:
    """Wasserstein distance that recordings drawn from recordings stay below in 97.5 % of cases.

    ``number`` values on one side and as many as there are on the other, without regard to starts.
    """
    even = np.full(len(recorded), 1.0 / len(recorded))
    first, second = (
        rng.multinomial(count, even, size=resamples).astype(np.float64)
        for count in (number, len(recorded))
    )
    drawn = wasserstein_weighted(recorded, first, recorded, second)
    return percentile_interval(0.0, drawn).high


def _finite(values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64).ravel()
    return array[np.isfinite(array)]


# -- energy score ---------------------------------------------------------------------------------


def energy_score(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """The unbiased estimate for one start, in the values' unit.

    ``simulated`` is ``(rollouts,)`` and ``recorded`` a number, or ``(rollouts, d)`` and ``(d,)``:
    ``d`` numbers are compared by Euclidean distance. A single estimate may be negative; NaN for
    fewer than two rollouts, which do not show a spread.
    """
    drawn = np.asarray(simulated, np.float64)
    number = len(drawn)
    if number < 2:
        return math.nan
    drawn, true = drawn.reshape(number, -1), np.asarray(recorded, np.float64).reshape(-1)
    error = np.linalg.norm(drawn - true, axis=1).mean()
    apart = np.linalg.norm(drawn[:, None] - drawn[None], axis=2).sum()
    return float(error - apart / (2 * number * (number - 1)))


def energy_scores(simulated: ArrayLike, demo: ArrayLike, recorded: ArrayLike) -> Floats:
    """The score at every start, ``(starts,)``; ``demo`` ``(rollouts,)`` is the start of each."""
    drawn, start = np.asarray(simulated, np.float64), np.asarray(demo)
    return np.array(
        [energy_score(drawn[start == i], one) for i, one in enumerate(np.asarray(recorded))]
    )


def energy_cells(
    simulated: ArrayLike, seed: ArrayLike, demo: ArrayLike, recorded: ArrayLike
) -> Cells:
    """The score of every training seed at every start; NaN values do not count."""
    drawn, of, start = np.asarray(simulated, np.float64), np.asarray(seed), np.asarray(demo)
    seeds, known = np.unique(of), np.isfinite(drawn).reshape(len(drawn), -1).all(axis=1)
    rows = [(drawn[chosen], start[chosen]) for chosen in ((of == one) & known for one in seeds)]
    return single_cells(np.array([energy_scores(*row, recorded) for row in rows]))


def pooled_score(recorded: ArrayLike) -> float:
    """What the recordings of the *other* starts would score, drawn as if they were rollouts.

    A simulator of the right distribution that does not know its start scores this on average; one
    that knows it scores less.
    """
    true = np.asarray(recorded, np.float64)
    scores = [energy_score(np.delete(true, i, 0), one) for i, one in enumerate(true)]
    return float(np.mean(scores)) if len(true) > 2 else math.nan
