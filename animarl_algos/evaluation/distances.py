"""How far distributions of a metric are apart: kernel density, Wasserstein, energy score.

The kernel-density distance is the paper's measure of similarity (Statistical analysis). It is
biased upwards, so every value comes with what a perfect simulator gives, and with the Wasserstein
distance, which is less biased and has the metric's unit. The energy score (Gneiting and Raftery
2007, J. Am. Stat. Assoc. 102, 359) compares the rollouts X, X' of a start with the recording y from
there: E|X - y| - E|X - X'| / 2 is smallest on average for the distribution that y is drawn from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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


@dataclass(frozen=True)
class KdeRule:
    """The grid and the smallest bandwidth, fixed once for all samples that are compared.

    The bandwidth of a sample is Scott's, as in ``scipy.stats.gaussian_kde``, but never less than
    ``floor``, so that values without any variance (every episode timing out) are a narrow peak.
    """

    start: float
    step: float
    floor: float

    @property
    def grid(self) -> Floats:
        return np.asarray(self.start + self.step * np.arange(KDE_GRID))


def kde_rule(*samples: ArrayLike) -> KdeRule | None:
    """The rule for these samples together; ``None`` if all their values are equal."""
    arrays = [np.asarray(sample, dtype=np.float64) for sample in samples]
    pooled = np.concatenate(arrays)
    spread = float(np.ptp(pooled))
    if spread <= 1e-9 * max(1.0, float(np.abs(pooled).max())):
        return None
    floor = KDE_FLOOR * spread
    widest = max(_scott(sample, floor) for sample in arrays)
    low, high = pooled.min() - KDE_MARGIN * widest, pooled.max() + KDE_MARGIN * widest
    return KdeRule(float(low), float((high - low) / (KDE_GRID - 1)), floor)


def kde_distance(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """L1 distance between two Gaussian kernel density estimates, from 0 (equal) to 2 (disjoint).

    It is biased upwards: two samples of 10 and 50 values from one normal distribution differ by
    about 0.39.
    """
    samples = _finite(simulated), _finite(recorded)
    if min(map(len, samples)) == 0:
        return math.nan
    rule = kde_rule(*samples)
    if rule is None:
        return 0.0
    densities = []
    for sample in samples:
        width = _scott(sample, rule.floor)
        z = (rule.grid[:, None] - sample) / width
        densities.append(np.exp(-0.5 * z**2).mean(axis=1) / (width * math.sqrt(math.tau)))
    return float(np.abs(densities[0] - densities[1]).sum() * rule.step)


def kde_floor(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """The smallest bandwidth, in the values' unit, where it acts on either sample; else NaN.

    It acts where values hardly vary, as when nearly all episodes time out, and the kernel-density
    distance then depends on it.
    """
    samples = _finite(simulated), _finite(recorded)
    rule = kde_rule(*samples) if min(map(len, samples)) else None
    if rule is None or min(_scott(sample, rule.floor) for sample in samples) > rule.floor:
        return math.nan
    return rule.floor


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
    share, rows = place - left, np.tile(np.arange(len(support)), 2)
    parts = np.concatenate([1.0 - share, share])
    binning = csr_array(
        (parts, (np.concatenate([left, left + 1]), rows)), shape=(KDE_GRID, len(support))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        mass = (binning @ weights.T).T / number[:, None]
    frequency = 2.0 * np.pi * np.fft.rfftfreq(2 * KDE_GRID)
    smooth = np.exp(-0.5 * np.square(width[:, None] / rule.step * frequency))
    return np.asarray(rfft(mass, n=2 * KDE_GRID, axis=1) * smooth)


def _on_grid(rule: KdeRule, spectra: NDArray[np.complex128]) -> Floats:
    from scipy.fft import irfft

    return np.asarray(irfft(spectra, n=2 * KDE_GRID, axis=1)[:, :KDE_GRID] / rule.step)


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


def bootstrap_distances(
    simulated: ArrayLike,
    recorded: ArrayLike,
    seed: ArrayLike,
    demo: ArrayLike,
    rng: np.random.Generator,
    resamples: int = DISTANCE_RESAMPLES,
) -> tuple[Interval, Interval]:
    """Kernel-density and Wasserstein distance with hierarchical bootstrap intervals.

    Values, training seeds and demonstrations of rollouts are ``(rollouts,)``, ``recorded`` is
    ``(demos,)``; NaN does not count. The kernel-density distance is biased upwards, and a resample
    repeats values, so its interval may lie above the estimate: it shows spread, the null shows the
    bias.
    """
    simulated = np.asarray(simulated, dtype=np.float64)
    recorded = np.asarray(recorded, dtype=np.float64)
    counts, present = np.isfinite(simulated), np.isfinite(recorded)
    estimates = kde_distance(simulated, recorded), wasserstein(simulated, recorded)
    if not counts.any() or not present.any() or len(recorded) < 2:
        reason = ONE_DEMO if counts.any() and present.any() else NO_VALUE
        return Interval(estimates[0], reason=reason), Interval(estimates[1], reason=reason)
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    demo_weights = draw_weights(rng, len(recorded), resamples)
    seed_weights = draw_weights(rng, len(seeds), resamples)
    first = seed_weights[:, row.ravel()[counts]] * demo_weights[:, np.asarray(demo)[counts]]
    drawn = weighted_distances(
        simulated[counts], first, recorded[present], demo_weights[:, present]
    )
    return percentile_interval(estimates[0], drawn[0]), percentile_interval(estimates[1], drawn[1])


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


def _scott(sample: Floats, floor: float) -> float:
    """Scott's bandwidth of a sample, at least ``floor``."""
    if len(sample) < 2:
        return floor
    return max(float(np.std(sample, ddof=1)) * math.pow(len(sample), -0.2), floor)


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
