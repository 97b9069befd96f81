"""Distances between distributions: known answers, and agreement with SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from animarl_algos.evaluation.distances import (
    bootstrap_distances,
    kde_distance,
    kde_rule,
    kde_weighted,
    null_distances,
    wasserstein,
)
from animarl_algos.evaluation.statistics import draw_weights


def textbook_kde_distance(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    grid = np.linspace(-30, 30, 20_001)
    densities = [stats.gaussian_kde(sample)(grid) for sample in (first, second)]
    return float(np.trapezoid(np.abs(densities[0] - densities[1]), grid))


def test_kde_distance_known_answers() -> None:
    rng = np.random.default_rng(10)
    sample = rng.normal(size=60)
    assert kde_distance(sample, sample) == 0.0
    assert kde_distance(sample, sample + 100.0) == pytest.approx(2.0, abs=1e-3)


def test_kde_distance_equals_scipys_densities_integrated() -> None:
    rng = np.random.default_rng(11)
    for shift in (0.0, 0.7, 3.0):
        first, second = rng.normal(size=25), rng.gamma(2.0, size=60) + shift
        assert kde_distance(first, second) == pytest.approx(
            textbook_kde_distance(first, second), abs=2e-3
        )


def test_kde_distance_is_symmetric_and_free_of_scale() -> None:
    rng = np.random.default_rng(12)
    first, second = rng.normal(size=30), rng.normal(0.5, 2.0, 50)
    distance = kde_distance(first, second)
    assert kde_distance(second, first) == pytest.approx(distance)
    assert kde_distance(1000 * first + 7, 1000 * second + 7) == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([14.8] * 5, [14.8] * 9, 0.0),  # every episode timed out, here and there
        ([14.8] * 5, [3.0] * 9, 2.0),
        ([14.8], [3.0], 2.0),
        ([14.8], [14.8], 0.0),
    ],
)
def test_kde_distance_without_variance(
    first: list[float], second: list[float], expected: float
) -> None:
    assert kde_distance(first, second) == pytest.approx(expected, abs=1e-3)


def test_kde_distance_of_a_peak_to_a_spread() -> None:
    spread = np.random.default_rng(13).uniform(0, 14.8, 50)
    assert 1.7 < kde_distance([14.8] * 50, spread) < 2.0


def test_distances_of_nothing_are_undefined() -> None:
    assert np.isnan(kde_distance([], [1.0, 2.0])) and np.isnan(wasserstein([np.nan], [1.0]))
    nothing = bootstrap_distances([np.nan], [1.0], [0], [0], np.random.default_rng(0))
    assert np.isnan(nothing.kde.estimate)
    assert np.isnan(null_distances([], 5, np.random.default_rng(0)).kde.estimate)


def test_binned_density_equals_the_exact_one() -> None:
    rng = np.random.default_rng(14)
    sample, other = rng.normal(size=80), rng.normal(4, 0.5, 20)
    rule = kde_rule(sample, other)
    assert rule is not None
    weights = draw_weights(rng, len(sample), 10)
    fast = kde_weighted(rule, sample, weights)
    for b in range(10):
        drawn = np.repeat(sample, weights[b].astype(int))
        exact = stats.gaussian_kde(drawn)(rule.grid)
        assert np.abs(fast[b] - exact).sum() * rule.step < 5e-3


def test_wasserstein_equals_scipy() -> None:
    rng = np.random.default_rng(15)
    first, second = rng.normal(size=31), rng.exponential(size=17)
    assert wasserstein(first, second) == pytest.approx(stats.wasserstein_distance(first, second))
    assert wasserstein(first, first + 2.5) == pytest.approx(2.5)


def test_null_reference_shows_the_bias() -> None:
    """Ten values against fifty of one distribution differ by 0.3 to 0.5; more values by less."""
    rng = np.random.default_rng(16)
    direct = np.mean(
        [kde_distance(rng.exponential(size=10), rng.exponential(size=50)) for _ in range(100)]
    )
    assert 0.3 < direct < 0.5
    recorded = rng.exponential(size=50)
    null = null_distances(recorded, 10, rng, 400)
    assert null.kde.estimate == pytest.approx(direct, abs=0.1)
    assert null.kde.low < null.kde.estimate < null.kde.high
    many = null_distances(recorded, 1000, rng, 400, num_recorded=1000)
    assert many.kde.estimate < 0.15
    assert many.wasserstein.estimate < null.wasserstein.estimate


def test_bootstrap_distances_surround_a_large_distance() -> None:
    rng = np.random.default_rng(17)
    demo, seed = np.tile(np.arange(30), 4), np.repeat([0, 1], 60)
    recorded = rng.normal(size=30)
    simulated = recorded[demo] + 2.0 + rng.normal(0, 0.2, len(demo))
    both = bootstrap_distances(simulated, recorded, seed, demo, rng, 400)
    assert both.wasserstein.low < 2.0 < both.wasserstein.high
    assert both.kde.low < both.kde.estimate < both.kde.high < 2.0
    null = null_distances(recorded, len(simulated), rng, 400)
    assert both.kde.low > null.kde.high
