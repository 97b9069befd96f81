"""Submissions: what is scored, and each that could not be what it claims refused in a sentence."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animarl_algos.benchmark.methods import Steering
from animarl_algos.benchmark.submission import read_submission, score_submission, write_submission
from animarl_algos.cli.main import main
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.demos.packaged import load_packaged, packaged_names
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
    return write_submission(made, "fly", tmp_path_factory.mktemp("submission") / "mine.json")


def test_benchmark_scores_a_submission(submission: Path) -> None:
    found = score_submission(submission, resamples=20)
    assert found.method == "mine" and found.rollouts == 20 and found.starts == 10
    assert found.of("auc").value > 0.5


def damage(path: Path, to: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    content = json.loads(path.read_text())
    change(content)
    to.write_text(json.dumps(content))
    return to


def claimed(content: dict[str, Any]) -> Any:
    """A rollout that did not reach its goal."""
    return next(one for one in content["rollouts"] if one["outcome"] <= 0)


def left_out(content: dict[str, Any], demo: int) -> None:
    content["rollouts"] = [one for one in content["rollouts"] if one["demo"] != demo]
    content["episodes"] = len(content["rollouts"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(episodes=21), "claims 21 episodes and holds 20"),
        (lambda c: c.update(species="cat"), "species is 'cat'"),
        (lambda c: c.update(fingerprint="0"), "its fingerprint is '0'"),
        (lambda c: c.update(version=2), "its version is 2"),
        (lambda c: c.update(format="x"), "no submission"),
        (lambda c: c.update(note="x"), "key 'note' is unknown"),
        (lambda c: c.pop("method"), "method is missing"),
        (lambda c: c["rollouts"][3].update(demo=10), "rollout 3: demo is 10"),
        (lambda c: c["rollouts"][3].update(seed="1"), "rollout 3: seed is '1'"),
        (lambda c: c["rollouts"][1].update(repetition=0), "same demo, seed and repetition"),
        (lambda c: c["rollouts"][0]["positions"][0].pop(), "positions are not"),
        (lambda c: c["rollouts"][0]["positions"][1].__setitem__(0, [np.nan, 0]), "finite"),
        (lambda c: c["rollouts"][0]["positions"][1].__setitem__(0, ["0.1", 0]), "not all numbers"),
        (lambda c: c["rollouts"][0]["positions"].pop(0), "does not begin where"),
        (lambda c: c["rollouts"][2].update(outcome=9), "outcome 9 is none"),
        (lambda c: claimed(c).update(outcome=1), "claims that the goal was reached"),
        (lambda c: left_out(c, 4), "no rollout is from test episode 4"),
    ],
)
def test_benchmark_refuses_a_submission(
    submission: Path, tmp_path: Path, change: Callable[[dict[str, Any]], Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        read_submission(damage(submission, tmp_path / "bad.json", change))


# -- what could not be ----------------------------------------------------------------------------


def put(value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda content: content["rollouts"][1]["positions"][2][1].__setitem__(0, value)


def shift(frame: int, by: float) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        path = np.array(content["rollouts"][2]["positions"])
        path[frame:] += by
        content["rollouts"][2]["positions"] = path.tolist()

    return change


def two_frames(content: dict[str, Any]) -> None:
    for one in content["rollouts"]:
        one.update(outcome=TIME_OUT, positions=one["positions"][:2])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (two_frames, "time ran out, with 2 of 501 frames"),
        *(
            (lambda c, o=o: c["rollouts"][0].update(outcome=o), "claims that somebody left")
            for o in (TARGET_OUT, PURSUER_OUT)
        ),
        *(
            (shift(frame, by), f"moves .* from frame {frame - 1} to {frame}, where")
            for frame, by in ((1, 0.3), (3, -0.3), (4, 0.1))
        ),
        *((put(value), "a coordinate is .* in size, and") for value in (1e308, -1e308, 3.0)),
        (put(10**400), "positions are not"),
    ],
)
def test_submissions_hold_what_could_be(
    submission: Path, tmp_path: Path, change: Callable[[dict[str, Any]], Any], said: str
) -> None:
    """Refused in a sentence that names the file and the rollout, and nothing overflows."""
    bad = damage(submission, tmp_path / "bad.json", change)
    with pytest.raises(InputError, match=said) as refused:
        read_submission(bad)
    assert str(refused.value).startswith(f"{bad}: rollout ") and "\n" not in str(refused.value)


@pytest.mark.parametrize("species", packaged_names())
def test_submissions_of_the_recordings_are_refused(species: str, tmp_path: Path) -> None:
    test = load_packaged(species).select(split="test")
    recorded = Rollouts.from_demonstrations(test)
    once = replace(recorded, seed=np.zeros_like(recorded.seed))
    twice = Rollouts.concatenate([once, replace(once, repetition=once.repetition + 1)], "mine")
    rounding = twice.positions.round(4)
    for copies in (once, twice, replace(twice, positions=rounding)):
        path = write_submission(copies, species, tmp_path / "copies.json")
        with pytest.raises(InputError, match=r"rollout \d+: it is the recording of test episode"):
            read_submission(path)


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
    path = write_submission(replace(made, positions=positions), species, tmp_path / "jump.json")
    with pytest.raises(InputError, match=r"rollout 0: .* moves .* from frame 0 to 1, where"):
        read_submission(path)


def test_submissions_are_refused_by_the_command(
    submission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    bad = damage(submission, tmp_path / "bad.json", put(1e308))
    monkeypatch.setattr(sys, "argv", ["animarl", "benchmark", "score", str(bad)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and "rollout 1: " in said


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
    found, _ = read_submission(write_submission(made, species, tmp_path / "made.json"))
    assert len(found) == len(made)
    assert get_species(species).time_limit + 1 >= found.lengths.max()
