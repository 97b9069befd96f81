"""Figures for papers: panels on any axes, their numbers beside them, and what is refused."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from refusals import refuses
from report_inputs import report_inputs
from small_runs import made

from animarl_algos.evaluation.order_in_time import stretches
from animarl_algos.report import panels
from animarl_algos.runs.evaluating import figure_sides
from animarl_envs.errors import InputError

BEGIN = {"pdf": b"%PDF", "svg": b"<?xml", "png": b"\x89PNG"}


@pytest.fixture(scope="module")
def sides() -> panels.SideBySide:
    inputs = report_inputs()
    return panels.SideBySide(inputs.demos, inputs.rollouts["dqdil"], inputs.evaluation.verdict)


@pytest.mark.parametrize("kind", BEGIN)
def test_a_figure_has_the_table_of_each_panel_beside_it(
    kind: str, sides: panels.SideBySide, tmp_path: Path
) -> None:
    names = panels.fitting_panels(sides) if kind == "pdf" else ["speeds", "verdict"]
    out, again = tmp_path / f"fig.{kind}", tmp_path / f"again.{kind}"
    written = panels.write_panels(sides, names, out)
    assert [file.name for file in written[1:]] == [f"fig-{name}.csv" for name in names]
    assert all(len(pd.read_csv(file)) > 1 for file in written[1:])
    panels.write_panels(sides, names, again)
    assert out.read_bytes() == again.read_bytes() and out.read_bytes().startswith(BEGIN[kind])


def test_a_figure_has_the_width_of_the_journal(sides: panels.SideBySide) -> None:
    for given, width in (("single", 89.0), ("double", 183.0), ("120", 120.0)):
        figure, _ = panels.draw_panels(sides, ["speeds", "turning"], panels.width_in_mm(given))
        assert figure.get_figwidth() * 25.4 == pytest.approx(width)
    for wrong in ("wide", "3", "nan"):
        refuses("give single, double", panels.width_in_mm, wrong)


def test_a_figure_panel_draws_on_any_axes_what_it_returns(sides: panels.SideBySide) -> None:
    ax = Figure().subplots()
    table = panels.turning(ax, sides)
    width = table["high"] - table["low"]
    assert (table[["demonstrated", "simulated"]].mul(width, axis=0).sum() - 1).abs().max() < 1e-9
    heights = [np.asarray(patch.get_data().values) for patch in ax.patches]
    np.testing.assert_array_equal(heights, table[["demonstrated", "simulated"]].T)
    paths = panels.paths(Figure().subplots(), sides)
    recorded = paths[paths["side"] == "demonstrated"]
    episode = list(sides.demos.recording).index(recorded["recording"].iloc[0])
    np.testing.assert_allclose(
        recorded.iloc[:, -2:].to_numpy(), sides.demos.path(episode).reshape(-1, 2)
    )


def test_bouts_of_a_figure_are_counted_whole() -> None:
    moving = np.array([[1, 1, 0, 1, 0, 0], [0, 1, 1, 1, 1, 1]], bool)[..., None]
    assert stretches(moving).tolist() == [2, 1, 5] and stretches(~moving).tolist() == [1, 2, 1]


def test_a_figure_that_cannot_be_drawn_is_refused(sides: panels.SideBySide, tmp_path: Path) -> None:
    refuses("'wings' is unknown", panels.draw_panels, sides, ["wings"], 89.0)
    refuses("choose .pdf", panels.write_panels, sides, ["speeds"], tmp_path / "fig.gif")
    bare = dataclasses.replace(sides, verdict=None)
    refuses("animarl evaluate", panels.draw_panels, bare, ["verdict"], 89.0)
    assert "verdict" not in panels.fitting_panels(bare)
    assert not any(tmp_path.iterdir())


def test_the_figure_of_a_run_has_its_saved_rollouts(tmp_path: Path) -> None:
    run = made(tmp_path, "soft-bc", rolled_out=False)
    assert len(figure_sides(run).rollouts) == 5 * len(run.demos.select(split="test"))
    run = made(tmp_path, "soft-bc", seed=1)
    sides = figure_sides(run)
    np.testing.assert_array_equal(sides.rollouts.positions, run.rollouts()["SOFT-BC"].positions)
    with pytest.raises(InputError, match="animarl evaluate"):
        panels.verdict(Figure().subplots(), sides)
