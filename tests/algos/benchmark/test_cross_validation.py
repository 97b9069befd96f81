"""Cross-validation: every episode is tested once, by what was trained without its recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from test_benchmark import rows_of, run_plan, tiny

from animarl_algos.benchmark.matrix import Matrix, Plan, plan
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import cross_validated
from animarl_envs.errors import InputError

FOLDS = 3


@pytest.fixture(scope="module")
def recordings() -> Demonstrations:
    """Twelve episodes of six recordings, no two of a recording side by side."""
    few = load_packaged("agent").select(episodes=np.arange(12))
    return replace(few, recording=np.array([f"day {i % 6}" for i in range(12)]))


@pytest.fixture(scope="module")
def asked(recordings: Demonstrations, tmp_path_factory: pytest.TempPathFactory) -> Plan:
    file = recordings.save(tmp_path_factory.mktemp("crossed") / "days.npz")
    references = ("recordings", "tracking", "still")
    mine: dict[str, Any] = {"files": {"days": str(file)}, "folds": {"days": FOLDS}}
    return plan(tiny(species=(), episodes={}, seeds=(0,), references=references, **mine))


@pytest.fixture(scope="module")
def finished(asked: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("crossed") / "out"
    assert not run_plan(asked, out).errors
    return out


@pytest.fixture(scope="module")
def rows(finished: Path) -> dict[str, pd.DataFrame]:
    """The rows of the leaderboard by method, and their measures by name."""
    return rows_of(finished)


def test_every_episode_is_test_once_and_val_once(recordings: Demonstrations) -> None:
    folds = list(cross_validated(recordings, FOLDS))
    for split in ("test", "val"):
        assert (sum((fold.split == split).astype(int) for fold in folds) == 1).all()
    for fold in folds:
        splits = [set(fold.recording[fold.split == s]) for s in ("train", "val", "test")]
        assert all(splits) and not (splits[0] & splits[1] or splits[2] & (splits[0] | splits[1]))


def test_episodes_are_dealt_where_recordings_are_few(recordings: Demonstrations) -> None:
    one = replace(recordings, recording=np.full(len(recordings), "only"))
    tested = [np.flatnonzero(fold.split == "test") for fold in cross_validated(one, 6)]
    assert sorted(np.concatenate(tested).tolist()) == list(range(12))


@pytest.mark.parametrize("folds", [2, 7])
def test_folds_need_recordings(recordings: Demonstrations, folds: int) -> None:
    with pytest.raises(InputError, match=f"{folds} folds of 6 recordings"):
        list(cross_validated(recordings, folds))


def test_benchmark_crosses_own_recordings(
    finished: Path, asked: Plan, rows: dict[str, pd.DataFrame]
) -> None:
    assert len(asked.worlds) == FOLDS and len(asked.cells) == 4 * FOLDS
    assert len({cell.key for cell in asked.cells}) == 4 * FOLDS
    assert {name: row["rollouts"].iloc[0] for name, row in rows.items()} == {
        "soft-bc": 24, "recordings": 12, "tracking": 12, "still": 24,
    }  # fmt: skip
    assert {row["starts"].iloc[0] for row in rows.values()} == {12}
    assert "12 test starts, cross-validated in 3 folds" in (finished / "leaderboard.md").read_text()
    assert "| days/soft-bc | 1 |" in (finished / "costs.md").read_text()  # one seed, not three


def test_benchmark_measures_rollouts_against_their_own_starts(
    rows: dict[str, pd.DataFrame],
) -> None:
    """What tracks the recordings is at zero from them, if every rollout meets its own recording."""
    measure = rows["tracking"].loc["dtw_per_step"]
    assert measure["value"] < 0.05 * measure["null"]


def test_recordings_are_not_told_from_themselves(rows: dict[str, pd.DataFrame]) -> None:
    """Over all folds the same episodes stand on both sides, and the sides could be learned."""
    area = rows["recordings"].loc["auc"]
    assert np.array_equal(area["null"], area["high"], equal_nan=True)  # of so few: no interval
    assert 0.35 < area["value"] < 0.65


def test_benchmark_compares_each_recording_once_with_another(
    finished: Path, asked: Plan, recordings: Demonstrations
) -> None:
    seen = []
    for cell in asked.only(["days/recordings"]).cells:
        demos = cell.world_run(finished).demos
        made: Rollouts = cell.rollouts(finished)
        starts = np.flatnonzero(demos.split == "test")[made.demo]
        for i, start in enumerate(starts.tolist()):
            recorded = np.split(demos.positions, demos.offsets[1:-1])
            same = [e for e in range(12) if np.array_equal(recorded[e], made.path(i))]
            assert len(same) == 1 and demos.recording[same[0]] != demos.recording[start]
            seen += same
    assert sorted(seen) == list(range(12))


def test_benchmark_only_takes_all_folds_or_one(asked: Plan) -> None:
    assert len(asked.only(["days/soft-bc/0"]).cells) == FOLDS
    assert len(asked.only(["days/soft-bc/0"]).scorings) == 1
    one = asked.only(["days/soft-bc/0/fold1"])
    assert [cell.name for cell in one.cells] == ["days/soft-bc/0/fold1"] and not one.scorings


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"folds": {"mice": 6}}, "folds names 'mice': choose among agent"),
        ({"folds": {"agent": 6}, "episodes": {"test": 4}}, "folds need all episodes"),
        ({"folds": {"agent": "six"}}, "folds of agent is 'six'"),
    ],
)
def test_benchmark_refuses_wrong_folds(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Matrix(species=("agent",), recipes=("bc",), **changed)
