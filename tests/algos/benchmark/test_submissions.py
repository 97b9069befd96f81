"""Submissions that could not be are refused in a sentence; cross-validation tests all once."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commands import Done, refused
from refusals import refuses
from test_benchmark import rows_of, run_plan, tiny

from animarl_algos.benchmark.matrix import Plan, plan
from animarl_algos.benchmark.scores import read_submission, score_submission
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import cross_validated, run_folds
from animarl_envs.errors import InputError
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world


def read_flies(file: Path) -> Rollouts:
    return read_submission(file, "fly", load_packaged("fly"))


@pytest.fixture(scope="module")
def submission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random actions from the packaged fly's test starts."""
    scenario = make_scenario("fly", split="test")
    made = collect_rollouts(
        partial(make_world, scenario), RandomPolicy(0), method="mine", seed=0, repetitions=2
    )
    return made.save(tmp_path_factory.mktemp("submission") / "mine.npz")


def test_benchmark_scores_a_submission(submission: Path) -> None:
    found = score_submission(submission, "fly", resamples=20)
    assert found.method == "mine" and found.rollouts == 20 and found.starts == 10
    assert found.by_measure["auc"]["value"] > 0.5


Change = Callable[[Rollouts], Rollouts]


def damage(path: Path, to: Path, change: Change) -> Path:
    return change(Rollouts.load(path)).save(to)


def entry(key: str, rollout: int, value: int) -> Change:
    """One entry of an array with an entry per rollout."""

    def change(made: Rollouts) -> Rollouts:
        array = getattr(made, key).copy()
        array[rollout] = value
        return replace(made, **{key: array})

    return change


def moved(rollout: int, change: Callable[[Any], Any]) -> Change:
    """The path of one rollout changed."""

    def changed(made: Rollouts) -> Rollouts:
        paths = [made.path(i) for i in range(len(made))]
        paths[rollout] = change(paths[rollout].copy())
        lengths = np.array([len(path) for path in paths])
        return replace(made, positions=np.concatenate(paths), lengths=lengths)

    return changed


def test_benchmark_refuses_what_is_no_submission(submission: Path, tmp_path: Path) -> None:
    refuses("--species cat: choose among", score_submission, submission, "cat")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match=r"text\.npz: it is not a plain npz archive"):
        read_flies(tmp_path / "text.npz")
    test = load_packaged("fly").select(split="test")
    with pytest.raises(InputError, match="holds no rollouts of this project"):
        read_flies(test.save(tmp_path / "recorded.npz"))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("lengths", 2**62, r"episode 1 has 4611686018427387904 frames"),
        ("lengths", 17.7, r"lengths: 17\.7 is no whole number"),
        ("outcome", 257, "outcome: 257 is no"),
        ("condition", 256, "condition: 256 is no"),
    ],
)
def test_numbers_of_a_submission_are_checked_before_they_are_cast(
    submission: Path, tmp_path: Path, key: str, value: float, said: str
) -> None:
    with np.load(submission) as stored:
        arrays = dict(stored)
    arrays[key] = arrays[key].astype(type(value))
    arrays[key][1] = value
    bad = tmp_path / "bad.npz"
    np.savez(bad, **arrays)
    assert refuses(said, read_flies, bad).startswith(f"{bad}: ")


def test_rollouts_that_were_told_another_condition_are_left_out(
    submission: Path, tmp_path: Path
) -> None:
    made = Rollouts.load(submission)
    told = replace(made, cue=1 - made.condition, repetition=made.repetition + 2)
    both = Rollouts.concatenate([made, told]).save(tmp_path / "both.npz")
    assert len(read_flies(both)) == len(made)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda made: replace(made, dt=0.2), "its dt .0.2. are not those of fly"),
        (lambda made: replace(made, individuals=("a", "b", "c")), "its individuals"),
        (lambda made: made.select(made.demo != 4), "no rollout is from test episode 4"),
        (entry("demo", 3, 10), "rollout 3: demo is 10"),
        (entry("demo", 3, -1), "rollout 3: demo is -1"),
        (entry("repetition", 1, 0), "same demo, seed and repetition"),
        (moved(0, lambda path: path[1:]), "does not begin where"),
        (moved(0, lambda path: path[:1]), "it has 1 frames"),
        (entry("outcome", 2, 9), "outcome 9 is not a valid code: use -2 to 2"),
    ],
)
def test_submissions_begin_at_test_starts(
    submission: Path, tmp_path: Path, change: Change, said: str
) -> None:
    """Refused in a sentence that names the file and the rollout, and nothing overflows."""
    bad = damage(submission, tmp_path / "bad.npz", change)
    assert refuses(said, read_flies, bad).startswith(f"{bad}: ")


def test_submissions_are_refused_by_the_command(
    animarl: Callable[..., Done], submission: Path, tmp_path: Path
) -> None:
    bad = damage(submission, tmp_path / "bad.npz", entry("demo", 1, 10))
    refused(animarl("benchmark", "score", bad, "--species", "fly"), "rollout 1: ")


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
    one = replace(recordings, recording=np.full(len(recordings), "only"))  # episodes are dealt
    tested = [np.flatnonzero(fold.split == "test") for fold in cross_validated(one, 6)]
    assert sorted(np.concatenate(tested).tolist()) == list(range(12))
    for count in (2, 7):
        refuses(f"{count} folds of 6 recordings", list, cross_validated(recordings, count))


def test_folds_hold_every_condition_and_whole_animals() -> None:
    few = load_packaged("agent").select(episodes=np.arange(24))
    names = np.array([f"r{i}" for i in range(24)])
    animals = {name: f"animal {i // 2}" for i, name in enumerate(names)}
    condition = (np.arange(24) < 12).astype(np.int8)  # the first six animals
    provenance = {**few.provenance, "animals": animals}
    mixed = replace(few, recording=names, condition=condition, provenance=provenance)
    for fold in run_folds(mixed, 3):
        for split, count in (("test", 4), ("train", 6)):
            chosen = fold.condition[fold.split == split]
            assert np.bincount(chosen, minlength=2).min() >= count, (split, chosen)
        pairs = fold.split.reshape(-1, 2)
        assert (pairs[:, 0] == pairs[:, 1]).all()


@pytest.mark.slow
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


@pytest.mark.slow
def test_benchmark_measures_rollouts_against_their_own_starts(
    rows: dict[str, pd.DataFrame],
) -> None:
    """What tracks the recordings is at zero from them, if every rollout meets its own recording."""
    measure = rows["tracking"].loc["dtw_per_step"]
    assert measure["value"] < 0.05 * measure["null"]
    # Over all folds the same episodes stand on both sides, and the sides could be learned.
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
