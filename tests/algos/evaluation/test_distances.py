"""Distances between distributions: known answers, and agreement with SciPy."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from animarl_algos.evaluation.distances import (
    bootstrap_kde,
    densities,
    energy_cells,
    energy_score,
    energy_scores,
    kde_distance,
    kde_grid,
    pooled_score,
    recorded_null,
    wasserstein,
    wasserstein_weighted,
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


def test_the_grid_reaches_four_of_the_widest_bandwidths_beyond_the_values() -> None:
    """By hand: (0, 2) has the standard deviation sqrt(2); one value has the least width."""
    grid, widths = kde_grid([0.0, 2.0], [10.0]) or (np.zeros(0), [])
    widest = 2.0**0.5 * 2.0**-0.2
    assert widths == pytest.approx([widest, 0.01 * 10.0])
    assert len(grid) == 512
    assert grid[[0, -1]] == pytest.approx([-4.0 * widest, 10.0 + 4.0 * widest])
    narrow, _ = kde_grid([0.0], [10.0]) or (np.zeros(0), [])
    assert narrow[[0, -1]] == pytest.approx([-0.4, 10.4])


def test_values_that_differ_by_rounding_alone_are_equal() -> None:
    assert kde_grid([0.0], [1e-10]) is None and kde_grid([1e6], [1e6 + 1e-4]) is None
    assert kde_grid([0.0], [1e-8]) is not None and kde_grid([1e6], [1e6 + 1e-2]) is not None


def test_kde_distance_of_very_small_samples() -> None:
    first, second = np.array([0.0, 1.0]), np.array([2.0, 2.7, 4.0])
    expected = textbook_kde_distance(first, second)
    assert kde_distance(first, second) == pytest.approx(expected, abs=2e-3)


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
    nothing = bootstrap_kde([np.nan], [1.0], [0], [0], np.random.default_rng(0))
    assert np.isnan(nothing.estimate)


def test_weighted_densities_are_those_of_repeated_values() -> None:
    rng = np.random.default_rng(14)
    sample, grid = rng.normal(size=80), np.linspace(-5.0, 5.0, 101)
    weights = draw_weights(rng, len(sample), 10)
    drawn = densities(grid, 0.3, sample, weights)
    for b in range(10):
        repeated = np.repeat(sample, weights[b].astype(int))
        exact = stats.gaussian_kde(repeated, 0.3 / repeated.std(ddof=1))(grid)
        assert drawn[b] == pytest.approx(exact)


def test_wasserstein_equals_scipy() -> None:
    rng = np.random.default_rng(15)
    first, second = rng.normal(size=31), rng.exponential(size=17)
    assert wasserstein(first, second) == pytest.approx(stats.wasserstein_distance(first, second))
    assert wasserstein(second, first) == pytest.approx(wasserstein(first, second))
    assert wasserstein(first, first + 2.5) == pytest.approx(2.5)


def test_weighted_wasserstein_equals_scipy() -> None:
    rng = np.random.default_rng(18)
    a, b = rng.normal(size=12), np.round(rng.normal(size=9), 1)
    b[3] = b[4] = a[0]  # ties within a sample and between the two
    first, second = (rng.integers(0, 4, (6, n)).astype(float) for n in (12, 9))
    found = wasserstein_weighted(a, first, b, second)
    for r in range(6):
        expected = stats.wasserstein_distance(a, b, first[r], second[r])
        assert found[r] == pytest.approx(expected)
    first[2] = 0.0  # nothing was drawn
    assert (
        np.isnan(wasserstein_weighted(a, first, b, second)).tolist()
        == [False] * 2 + [True] + [False] * 3
    )


def test_one_demonstration_leaves_nothing_to_resample() -> None:
    rng = np.random.default_rng(19)
    found = bootstrap_kde(
        rng.normal(size=30), [2.0], np.full(30, 7), np.zeros(30, dtype=int), rng, 20
    )
    assert np.isfinite(found.estimate) and np.isnan(found.low)
    assert found.reason.startswith("one demonstration")


def test_what_does_not_count_leaves_the_distances_alone() -> None:
    simulated, demo = np.array([1.0, np.nan, 2.0, 4.0]), np.array([0, 1, 2, 1])
    recorded = np.array([0.0, 5.0, np.nan])
    kde = bootstrap_kde(simulated, recorded, [3, 3, 8, 8], demo, np.random.default_rng(0))
    assert kde.estimate == pytest.approx(kde_distance([1.0, 2.0, 4.0], [0.0, 5.0]))
    nothing = bootstrap_kde([1.0], [np.nan], [0], [0], np.random.default_rng(0))
    assert np.isnan(nothing.estimate)


def test_the_bootstrap_surrounds_a_large_distance() -> None:
    rng = np.random.default_rng(17)
    demo, seed = np.tile(np.arange(30), 4), np.repeat([0, 1], 60)
    recorded = rng.normal(size=30)
    simulated = recorded[demo] + 2.0 + rng.normal(0, 0.2, len(demo))
    kde = bootstrap_kde(simulated, recorded, seed, demo, rng, 400)
    assert kde.low < kde.estimate < kde.high < 2.0


def test_recordings_drawn_from_recordings_are_the_nearer_the_more_they_are() -> None:
    rng = np.random.default_rng(20)
    assert recorded_null(np.array([0.0, 1.0]), 2, rng, 400) == pytest.approx(1.0)  # four coins
    few, many = rng.normal(size=10), rng.normal(size=160)
    assert recorded_null(many, 160, rng, 200) < 0.6 * recorded_null(few, 10, rng, 200)


# -- energy score ------------------------------------------------------------


def test_a_score_worked_out_by_hand() -> None:
    # mean error (1 + 3 + 0) / 3; pairs |1-(-3)|, |1-0|, |-3-0| once each: 8 / (3 * 2)
    assert energy_score([1.0, -3.0, 0.0], 0.0) == pytest.approx(4 / 3 - 8 / 6)
    assert energy_score([[3.0, 4.0], [0.0, 0.0]], [0.0, 0.0]) == pytest.approx(2.5 - 2.5)


def test_cells_hold_the_score_of_each_seed_and_start() -> None:
    rng = np.random.default_rng(4)
    values, recorded = rng.normal(size=60), np.array([0.5, np.nan, -1.0, 2.0])
    values[3] = np.nan
    seed, demo = rng.integers(5, 7, 60), rng.integers(0, 4, 60)
    found = energy_cells(values, seed, demo, recorded)
    assert found.counts[:, 1].tolist() == [0.0, 0.0]
    for row, one in enumerate((5, 6)):
        for start in (0, 2, 3):
            chosen = (seed == one) & (demo == start) & np.isfinite(values)
            expected = energy_score(values[chosen], recorded[start])
            assert found.sums[row, start] == pytest.approx(expected)
    assert energy_cells([1.0, 2.0], [0, 1], [0, 0], [1.0]).counts.sum() == 0


def test_one_rollout_shows_no_spread() -> None:
    assert math.isnan(energy_score([1.0], 0.0))
    scores = energy_scores([1.0, 2.0, 5.0], [0, 0, 1], [1.0, 5.0])
    assert scores[0] == pytest.approx(0.0)
    assert math.isnan(scores[1])


def test_it_is_unbiased_for_any_number_of_rollouts() -> None:
    rng = np.random.default_rng(0)
    means = [
        np.mean([energy_score(rng.normal(size=n), rng.normal()) for _ in range(6000)])
        for n in (2, 8)
    ]
    truth = 1 / math.sqrt(math.pi)  # E|X - Y| / 2 of two standard normal numbers
    assert np.allclose(means, truth, atol=0.035)


def test_the_perfect_simulator_beats_the_collapsed_one_with_two_rollouts_a_start() -> None:
    rng = np.random.default_rng(1)
    starts, experiments = 100, 200
    demo = np.repeat(np.arange(starts), 2)
    wins = absolute = 0
    for _ in range(experiments):
        centre = rng.normal(size=starts)
        recorded = centre + rng.normal(size=starts)
        perfect = centre[demo] + rng.normal(size=2 * starts)
        honest = energy_scores(perfect, demo, recorded).mean()
        flat = energy_scores(centre[demo], demo, recorded).mean()
        wins += honest < flat
        start_means = perfect.reshape(starts, 2).mean(axis=1)
        absolute += np.abs(start_means - recorded).mean() < np.abs(centre - recorded).mean()
    assert wins >= 0.99 * experiments
    assert absolute < 0.1 * experiments  # what it is there to replace


def test_to_know_the_start_is_worth_something() -> None:
    rng = np.random.default_rng(2)
    recorded = rng.normal(0.0, 3.0, 200)
    demo = np.repeat(np.arange(200), 2)
    knowing = energy_scores(recorded[demo] + rng.normal(size=400), demo, recorded).mean()
    assert knowing < 0.6 * pooled_score(recorded)
    assert pooled_score(recorded) == pytest.approx(3.0 / math.sqrt(math.pi), rel=0.15)
