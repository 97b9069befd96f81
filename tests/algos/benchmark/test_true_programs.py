"""What made the packaged sets, held to the bars of its clones."""

from __future__ import annotations

import numpy as np
import pytest

from animarl_algos.evaluation.verdict_rows import DIFFERS
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.locomotion import COAST
from benchmarks.true_programs import Courtship, bars_met, judged, rolled_out


def test_the_program_moves_as_the_flies_that_it_made() -> None:
    met = bars_met(judged("fly", seed=0, rollouts=50))
    assert "Duration" in met and any("classifier" in label for label in met)
    assert all(met.values())


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


def test_other_seeds_draw_other_rollouts() -> None:
    first, second = (judged("fly", seed, rollouts=10).row("duration") for seed in (0, 1))
    assert first["recorded"] == second["recorded"] and first["simulated"] != second["simulated"]
