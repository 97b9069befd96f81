"""The table of the paper's Figure 4, of methods that are known to be near and far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
import typer
from moving_pairs import recorded_pairs, simulated_pairs

from animarl_algos.benchmark.matrix import plan, read_matrix
from animarl_algos.evaluation.metrics import measure, measure_recordings
from benchmarks import figure4


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
    assert [panel.get_ylabel() for panel in panels] == [m.axis for m in figure4.SHOWN]


def test_an_unfinished_benchmark_is_one_sentence(tmp_path: Path) -> None:
    matrix = read_matrix("paper").changed(species=("agent",), seeds=(0,))
    with pytest.raises(typer.BadParameter, match=r"agent/dqn/0 is not finished: run 'animarl"):
        figure4.measured(plan(matrix).cells[:1], tmp_path)
