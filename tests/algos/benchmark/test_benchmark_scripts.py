"""Small parts of the benchmark scripts: scale, floors, the first hour, true programs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from moving_pairs import STARTS, recorded_pairs

from animarl_algos.benchmark.matrix import plan, read_matrix
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import DIFFERS
from animarl_algos.recipes.registry import named_recipe
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.locomotion import COAST
from benchmarks import scale
from benchmarks.split_floor import split_rows
from benchmarks.true_programs import Courtship, bars_met, judged, rolled_out


def test_every_learner_has_two_sizes_in_whole_rounds() -> None:
    units = []
    for cell in plan(read_matrix("short").changed(seeds=(0,))).cells:
        if cell.settings is None or not named_recipe(cell.method).algorithm.recipe.online:
            continue
        less, more = scale.few_steps(cell.settings)
        assert more == 3 * less >= 3 * scale.STEPS, cell
        learner = cell.settings.learner()
        every, unit = learner.settings.train_freq
        units.append(unit)
        assert unit == "episode" or less % (every * learner.n_envs) == 0, cell
    assert {"episode", "step"} <= set(units)
    # Cells are taken in turn by whoever is free.
    assert scale.makespan([3.0, 1.0, 1.0, 1.0], 2) >= 3.0
    assert scale.makespan([1.0] * 4, 1) > scale.makespan([1.0] * 4, 2)


def test_episodes_that_are_the_same_do_not_differ_and_later_ones_do() -> None:
    same = recorded_pairs().select(episodes=np.tile(np.arange(STARTS // 2), 2))
    half = np.repeat(["test", "train"], STARTS // 2)
    assert all(own == beside for _, own, beside, _ in split_rows(replace(same, split=half)))
    longest = np.argsort(recorded_pairs().lengths)
    by_length = replace(recorded_pairs().select(episodes=longest), split=half)
    found = {label: (own, beside, errors) for label, own, beside, errors in split_rows(by_length)}
    own, beside, errors = found["Duration"]
    assert beside > own
    assert errors > 3


TABLE = Path(__file__).parents[3] / "examples" / "data" / "lab_table.csv"


@pytest.mark.slow
def test_a_table_of_a_lab_becomes_a_simulator_within_a_quarter(tmp_path: Path) -> None:
    demos, run = tmp_path / "lab.npz", tmp_path / "lab"
    for words in (("import", TABLE, "--out", demos), ("run", demos, "--out", run)):
        animarl(*words)
    assert (run / "report.html").exists()
    found = Verdict.load(run / "evaluation")
    for name in ("median_speed", "duration", "reached"):
        row = found.row(name)
        assert row["simulated"] == pytest.approx(row["recorded"], rel=0.25)


@pytest.mark.slow
def test_the_program_moves_as_the_flies_that_it_made() -> None:
    met = bars_met(judged("fly", seed=0, rollouts=50))
    assert "Duration" in met and any("Classifier" in label for label in met)
    assert all(met.values())


@pytest.mark.slow
def test_flies_that_only_coast_miss_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    def coast(program: Courtship, observation: np.ndarray, **_: object) -> tuple[np.ndarray, None]:
        return np.full(len(observation), COAST), None

    monkeypatch.setattr(Courtship, "predict", coast)
    found = judged("fly", seed=0, rollouts=20)
    met = bars_met(found)
    assert [label for label, holds in met.items() if not holds] == [found.row("auc")["label"]]
    assert found.judgement == DIFFERS
    assert found.row("kinematic")["judgement"] == DIFFERS  # speeds hardly vary


@pytest.mark.parametrize("name", ["agent", "silkmoth"])
def test_teams_and_the_programmed_moth_begin_at_every_test_start(name: str) -> None:
    made, demos = rolled_out(name, seed=0, rollouts=1), load_packaged(name)
    assert np.unique(made.demo).tolist() == list(range(int((demos.split == "test").sum())))


@pytest.mark.slow
def test_other_seeds_draw_other_rollouts() -> None:
    first, second = (judged("fly", seed, rollouts=10).row("duration") for seed in (0, 1))
    assert first["recorded"] == second["recorded"] and first["simulated"] != second["simulated"]
