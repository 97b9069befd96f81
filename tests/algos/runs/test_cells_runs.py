"""Runs of animals that move by cells: from recordings to verdict, page, pictures and what-if."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import animarl
from recordings import group
from refusals import refuses
from small_runs import QUICK, few, made
from thrust_walks import walk

from animarl_algos.cli.fit import format_fit_table
from animarl_algos.data.recipe_choice import BY_CELLS
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_algos.whatif.live_page import write_page
from animarl_envs.cells import CellLocomotion
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.locomotion import Locomotion

CELLS = 16
CHASE = walk((Locomotion(0.2, 2.0), Locomotion(0.3, 1.0), Locomotion(0.25, 3.0)), 1)[0]


def trained(demos: Demonstrations, folder: Path) -> Run:
    """A run with the recipe of cells, trained for one epoch."""
    overrides: dict[str, Any] = QUICK | {"env_kwargs": {"cells": CELLS}}
    asked = RunSettings(
        file="own.npz", species="custom", steps=1, copies=2, repetitions=2, cloning=BY_CELLS,
        baselines=False, overrides=overrides,
    )  # fmt: skip
    run = pipeline.open_run(asked, folder, "animarl run own.npz", demos)
    pipeline.learn_all(run, progress_bar=False)
    return run


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of two animals that have no target."""
    return trained(group(2), tmp_path_factory.mktemp("cells") / "pair")


def test_cells_are_kept_with_the_fit_and_drawn_at_temperature_one(pair: Run) -> None:
    again = Run(pair.path)
    assert str(again.acting("soft-bc")) == "boltzmann:1"
    assert again.record["reasons"]["acting"]
    for before, own in zip(pair.species.locomotion, again.species.locomotion, strict=True):
        assert isinstance(own, CellLocomotion) and own.num_actions == CELLS
        assert own == before
    assert again.policy.policy.num_actions == CELLS
    one, two = (run.simulate(repetitions=1) for run in (pair, again))
    np.testing.assert_array_equal(one.positions, two.positions)


def test_cells_in_a_what_if_scale_each_step(pair: Run) -> None:
    answers = pair.what_if("speed=x1.3", repetitions=2)
    (answer,) = answers.answers
    (own, *_), (usual, *_) = answer.species.locomotion, pair.species.locomotion
    assert own.thrust == pytest.approx(1.3 * usual.thrust)
    assert not answer.thrusts  # none had to be found
    refuses("thrust belongs to pushes", pair.what_if, "all.thrust=x1.3")
    refuses("damping belongs to pushes", pair.what_if, "damping=x1.3")
    refuses("by a factor on each", pair.what_if, "speed=0.3")


def test_cells_have_no_live_page(pair: Run, tmp_path: Path) -> None:
    refuses("move by cells of recorded velocities", write_page, pair, tmp_path / "page.html")


def test_cells_are_adapted_online(tmp_path: Path) -> None:
    run = made(tmp_path, "dqdil-pt", demos=few("agent"), env_kwargs={"cells": CELLS})
    assert run.policy.policy.num_actions == CELLS
    caption = str(format_fit_table(run.fit, run.demos).caption)
    assert "16 cells of recorded velocities" in caption


@pytest.mark.slow
@pytest.mark.parametrize("demos", [group(1), group(2), group(5), CHASE], ids=str)
def test_cells_from_recordings_to_page(demos: Demonstrations, tmp_path: Path) -> None:
    run = trained(demos, tmp_path / "run")
    evaluation = pipeline.evaluate_run(run)
    assert evaluation.verdict.headline
    assert "cells of recorded velocities" in pipeline.report(run).read_text()
    animarl("watch", "--model", run.path, "--out", tmp_path / "film.gif", "--episodes", 1)
    assert (tmp_path / "film.gif").stat().st_size > 0
