"""The energy score: known answers, and what it is there for."""

import math

import numpy as np
import pytest

from animarl_algos.evaluation.statistics import (
    energy_cells,
    energy_score,
    energy_scores,
    pooled_score,
)


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
