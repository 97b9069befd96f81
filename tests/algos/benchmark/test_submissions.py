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
from animarl_algos.benchmark.methods import Steering
from animarl_algos.benchmark.scores import read_submission, score_submission
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.splits import cross_validated
from animarl_envs.errors import InputError
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SearchSpecies, get_species
from animarl_envs.worlds import make_world


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
    refuses("--species cat: choose among", read_submission, submission, "cat")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match=r"text\.npz: it is not a plain npz archive"):
        read_submission(tmp_path / "text.npz", "fly")
    test = load_packaged("fly").select(split="test")
    with pytest.raises(InputError, match="holds no rollouts of this project"):
        read_submission(test.save(tmp_path / "recorded.npz"), "fly")


def test_rollouts_that_were_told_another_condition_are_left_out(
    submission: Path, tmp_path: Path
) -> None:
    made = Rollouts.load(submission)
    told = replace(made, cue=1 - made.condition, repetition=made.repetition + 2)
    both = Rollouts.concatenate([made, told]).save(tmp_path / "both.npz")
    assert len(read_submission(both, "fly")[0]) == len(made)


def put(value: float) -> Change:
    def change(path: Any) -> Any:
        path[2, 1, 0] = value
        return path

    return moved(1, change)


def shift(frame: int, by: float) -> Change:
    def change(path: Any) -> Any:
        path[frame:] += by
        return path

    return moved(2, change)


def two_frames(made: Rollouts) -> Rollouts:
    first = np.concatenate([made.path(i)[:2] for i in range(len(made))])
    short = np.full(len(made), 2)
    return replace(made, positions=first, lengths=short, outcome=np.full(len(made), TIME_OUT))


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
        (entry("outcome", 2, 9), "outcome 9 is none"),
        (
            lambda made: entry("outcome", int(np.flatnonzero(made.outcome <= 0)[0]), 1)(made),
            "claims that the goal was reached",
        ),
        (two_frames, r": rollout \d+: .*time ran out, with 2 of 501 frames"),
        *((entry("outcome", 0, o), "claims that somebody left") for o in (TARGET_OUT, PURSUER_OUT)),
        *(
            (shift(frame, by), f": rollout 2: .*moves .* from frame {frame - 1} to {frame}, where")
            for frame, by in ((1, 0.3), (3, -0.3), (4, 0.1))
        ),
        *((put(v), "rollout 1: .*a coordinate is .* in size, and") for v in (1e308, -1e308, 3.0)),
    ],
)
def test_submissions_hold_what_could_be(
    submission: Path, tmp_path: Path, change: Change, said: str
) -> None:
    """Refused in a sentence that names the file and the rollout, and nothing overflows."""
    bad = damage(submission, tmp_path / "bad.npz", change)
    assert refuses(said, read_submission, bad, "fly").startswith(f"{bad}: ")


@pytest.mark.parametrize("species", packaged_names())
def test_submissions_of_the_recordings_are_refused(species: str, tmp_path: Path) -> None:
    test = load_packaged(species).select(split="test")
    recorded = Rollouts.from_demonstrations(test)
    once = replace(recorded, seed=np.zeros_like(recorded.seed))
    twice = Rollouts.concatenate([once, replace(once, repetition=once.repetition + 1)], "mine")
    rounding = twice.positions.round(4)
    for copies in (once, twice, replace(twice, positions=rounding)):
        path = copies.save(tmp_path / "copies.npz")
        refuses(r"rollout \d+: it is the recording of test episode", read_submission, path, species)


@pytest.mark.parametrize("species", packaged_names())
def test_submissions_of_no_species_jump_after_the_start(species: str, tmp_path: Path) -> None:
    scenario = make_scenario(species, split="test")
    policy = RandomPolicy(0, scenario.species.num_actions)
    made = collect_rollouts(
        partial(make_world, scenario), policy, method="mine", seed=0, repetitions=1
    )
    positions = made.positions.copy()
    later = np.ones(len(positions), dtype=bool)
    later[made.offsets[:-1]] = False
    positions[later, :, 0] -= np.sign(positions[later, :, 0].mean()) * 0.3  # inwards
    path = replace(made, positions=positions).save(tmp_path / "jump.npz")
    refuses(r"rollout 0: .* moves .* from frame 0 to 1, where", read_submission, path, species)


def test_submissions_are_refused_by_the_command(
    animarl: Callable[..., Done], submission: Path, tmp_path: Path
) -> None:
    bad = damage(submission, tmp_path / "bad.npz", put(1e308))
    refused(animarl("benchmark", "score", bad, "--species", "fly"), "rollout 1: ")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("species", packaged_names())
@pytest.mark.parametrize("acts", ["still", "held", "random", "scripted", "three thrusts"])
def test_submissions_of_rollouts_pass(species: str, acts: str, tmp_path: Path) -> None:
    """Whoever acts; who always acts alike gives the same rollout twice from every start."""
    scenario = make_scenario(species, split="test")
    spec = scenario.species
    if acts == "scripted":
        if isinstance(spec, SearchSpecies):
            return
        scenario = replace(scenario, drivers=("scripted",) * spec.num_individuals)
    if acts == "three thrusts":
        strong = [replace(own, magnitudes=(2.3, 1.0, 0.5)) for own in spec.locomotion]
        scenario = make_scenario(replace(spec, locomotion=tuple(strong)), split="test",
                                 demos=load_packaged(species))  # fmt: skip
    steering = {"still": 0.0, "held": 1.0}
    policy = (
        Steering(scenario, steering[acts])
        if acts in steering
        else RandomPolicy(0, scenario.species.num_actions)
    )
    made = collect_rollouts(
        partial(make_world, scenario), policy, method=acts, seed=0, repetitions=2
    )
    if acts in steering and not isinstance(spec, SearchSpecies):
        assert np.array_equal(made.path(0), made.path(1))
    found, _ = read_submission(made.save(tmp_path / "made.npz"), species)
    assert len(found) == len(made)
    assert get_species(species).time_limit + 1 >= found.lengths.max()


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
