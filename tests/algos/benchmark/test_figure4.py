"""The table of the paper's Figure 4, of methods that are known to be near and far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import typer
from moving_pairs import recorded_pairs, simulated_pairs
from scipy import stats

from animarl_algos.benchmark.matrix import plan, read_matrix
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.report.words import Words
from benchmarks import figure4
from benchmarks.figure4 import kde_distance


def test_what_stands_still_is_farther_from_the_recordings_than_what_repeats_them() -> None:
    demos = recorded_pairs()
    both = {"bc": "still", "dqdil": "true"}
    made = [replace(simulated_pairs(demos, kind), method=name) for name, kind in both.items()]
    metrics = pd.concat([measure_recordings(demos), *(measure(one, demos) for one in made)])
    far, near = figure4.table_of("agent", metrics)
    assert (far["method"], near["method"]) == ("bc", "dqdil")
    values = [float(row[figure4.KDE_PATH].split()[0]) for row in (far, near)]
    assert values[0] > 1.5 > 0.5 > values[1]
    assert far[figure4.LESS_THAN_BC] == ""
    assert near[f"{figure4.KDE_DURATION}: paper"] == "0.811 [0.687, 0.935]"
    panels = figure4.draw({"agent": metrics}).axes
    assert [panel.get_ylabel() for panel in panels] == [Words().axis(m) for m in figure4.SHOWN]


def test_an_unfinished_benchmark_is_one_sentence(tmp_path: Path) -> None:
    matrix = read_matrix("paper").changed(species=("agent",), seeds=(0,))
    with pytest.raises(typer.BadParameter, match=r"agent/dqn/0 is not finished: run 'animarl"):
        figure4.measured(plan(matrix).cells[:1], tmp_path)


def textbook_kde_distance(first: np.ndarray, second: np.ndarray) -> float:
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
    assert kde_distance(np.array(first), np.array(second)) == pytest.approx(expected, abs=1e-3)


def test_kde_distance_of_a_peak_to_a_spread() -> None:
    spread = np.random.default_rng(13).uniform(0, 14.8, 50)
    assert 1.7 < kde_distance(np.full(50, 14.8), spread) < 2.0


def test_the_bootstrap_surrounds_a_large_distance() -> None:
    rng = np.random.default_rng(17)
    demo, seed = np.tile(np.arange(30), 4), np.repeat([0, 1], 60)
    truth = pd.DataFrame({"demo": np.arange(30), "x": rng.normal(size=30)})
    drawn = truth["x"].to_numpy()[demo] + 2.0 + rng.normal(0, 0.2, len(demo))
    rows = pd.DataFrame({"seed": seed, "demo": demo, "x": drawn})
    found = figure4.kde_interval(rows, truth, "x")
    assert found.low < found.estimate < found.high < 2.0
