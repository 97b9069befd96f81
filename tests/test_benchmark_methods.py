"""Others' methods and submissions in the benchmark: what is asked of them, and what is refused."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animarl_algos.benchmark.matrix import Matrix
from animarl_algos.benchmark.methods import Checked, MethodSetting, parse_method, source_of
from animarl_algos.benchmark.pieces import attempt
from animarl_algos.benchmark.plan import plan
from animarl_algos.benchmark.references import Steering, others_as_rollouts
from animarl_algos.benchmark.scores import Measured, Score, first_second, start_energies
from animarl_algos.benchmark.submission import read_submission, score_submission, write_submission
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.locomotion import COAST
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

HERE = "test_benchmark_methods"


def make_raising(setting: MethodSetting) -> Callable[[Any], Any]:
    """A factory, as somebody might write one."""
    assert "test" not in setting.demos.split

    def act(observation: Any) -> Any:
        return 1 // 0

    return act


# -- others' methods ------------------------------------------------------------------------------


def test_benchmark_asks_predict_or_a_callable() -> None:
    seen = np.zeros((3, 2), dtype=np.float32)
    by_call = Checked("mine", lambda observation: np.full(len(observation), 2.0), 13)
    assert by_call.predict(seen)[0].tolist() == [2, 2, 2]
    assert Checked("mine", RandomPolicy(0), 13).predict(seen)[0].shape == (3,)
    with pytest.raises(InputError, match="no predict"):
        Checked("mine", 3, 13)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ([0, 1, 13], "gave action 13"),
        ([0, -1, 2], "gave action -1"),
        ([0, np.nan, 2], "gave NaN"),
        ([0, 0.5, 2], r"gave 0\.5"),
        ([0, 1], "of shape"),
        (["a", "b", "c"], "of shape"),
    ],
)
def test_benchmark_refuses_actions(answer: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Checked("mine", lambda _: np.array(answer), 13).predict(np.zeros((3, 2)))


def test_benchmark_looks_methods_up_at_once() -> None:
    assert parse_method(f"mine={HERE}:make_raising") == ("mine", f"{HERE}:make_raising")
    assert "#" in source_of(f"{HERE}:make_raising")
    for given, said in (
        ("mine", "write NAME=module:factory"),
        ("a/b=x:y", "write NAME=module:factory"),
        ("mine=module", "write module:factory"),
        ("mine=no_such_module_here:f", "cannot be imported"),
        (f"mine={HERE}:absent", "cannot be imported"),
        (f"mine={HERE}:HERE", "no callable"),
    ):
        with pytest.raises(InputError, match=said):
            parse_method(given)


def test_benchmark_examples_learn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "examples" / "benchmark"))
    methods = importlib.import_module("methods")
    monkeypatch.setattr(methods, "STEPS", 1)
    monkeypatch.setattr("animarl_algos.benchmark.matrix.WORLD_COPIES", 2)
    matrix = Matrix(
        species=("fly",), episodes={"train": 4, "val": 2, "test": 2}, repetitions=1, thrusts="1"
    )
    asked = plan(matrix, {"ppo": "methods:make_ppo", "rppo": "methods:make_recurrent_ppo"})
    assert not attempt(asked.worlds[0], tmp_path).error
    for cell in asked.cells:
        if cell.kind == "method":
            assert not attempt(cell, tmp_path).error
            assert cell.rollouts(tmp_path).method == cell.method


# -- references -----------------------------------------------------------------------------------


def test_benchmark_steering_holds_or_stops() -> None:
    scenario = make_scenario("agent", split="test")
    names = [one.name for one in make_world(scenario, 1).observation_components]
    ahead, left = names.index("own velocity ahead"), names.index("own velocity left")
    number = scenario.species.num_individuals
    for k, own in enumerate(scenario.species.locomotion):
        lost = own.thrust * scenario.species.dt / own.damping  # per step, what a thrust gives
        for velocity, hold, stop in (
            ((0.0, 0.0), COAST, COAST),
            ((lost, 0.0), 0, 6),
            ((-lost, 0.0), 6, 0),
            ((0.0, lost), 9, 3),
        ):
            seen = np.zeros((number, len(names)), dtype=np.float32)
            seen[k, [ahead, left]] = velocity
            assert Steering(scenario, keep=1.0).predict(seen)[0][k] == hold
            assert Steering(scenario, keep=0.0).predict(seen)[0][k] == stop


def test_benchmark_deals_each_other_recording_once() -> None:
    demos = load_packaged("agent")
    test = demos.select(split="test")
    others = demos.select(episodes=np.flatnonzero(demos.split != "test"))
    made = others_as_rollouts(others, test, 0)
    assert len(made) == len(others)
    assert (made.condition == test.condition[made.demo]).all()
    pairs = set(zip(made.demo.tolist(), made.repetition.tolist()))
    assert len(pairs) == len(made)
    counts = np.bincount(made.demo)
    for condition in (0, 1):
        there = counts[test.condition == condition]
        assert there.max() - there.min() <= 1


# -- measures -------------------------------------------------------------------------------------


def test_benchmark_energy_of_a_start_is_that_of_its_rollouts() -> None:
    drawn, true = np.array([[0.0], [2.0], [5.0], [7.0]]), np.array([[1.0], [4.0]])
    found = start_energies(drawn, np.array([3, 3, 3, 4]), np.array([0, 0, 1, 1]), true)
    assert found[0, 0] == pytest.approx(1.0 - 1.0)  # E|X - y| = 1, E|X - X'| / 2 = 1
    assert np.isnan(found[0, 1]) and np.isnan(found[1]).all()  # a single rollout has no spread


def test_benchmark_first_second_is_zero_for_the_recordings() -> None:
    test = load_packaged("agent").select(split="test")
    recorded = Rollouts.from_demonstrations(test)
    assert (first_second(recorded, test, 0) == 0).all()
    moved = Rollouts.from_demonstrations(test)
    positions = moved.positions.copy()
    ages = np.concatenate([np.arange(n) for n in moved.lengths])
    positions[ages > 10] += 1.0  # later than a second
    later = type(moved)(**{**vars(moved), "positions": positions})
    assert (first_second(later, test, 0) == 0).all()


def test_benchmark_score_survives_json() -> None:
    one = Measured("auc", value=0.5, low=0.4, high=0.6, null=0.55)
    made = Score(
        method="x", seeds=(1,), starts=2, rollouts=4, covers="", words="", measures=(one,),
        energies=np.array([[0.5, np.nan]]),
    )  # fmt: skip
    again = Score.from_json(json.loads(json.dumps(made.to_json(), allow_nan=False)))
    assert again.measures[0].inside and np.isnan(again.measures[0].p)
    assert again.energy_cells.counts.tolist() == [[1.0, 0.0]]


# -- submissions ----------------------------------------------------------------------------------


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
        (lambda c: c["rollouts"][0]["positions"].pop(0), "does not begin where"),
        (lambda c: c["rollouts"][2].update(outcome=9), "outcome 9 is none"),
    ],
)
def test_benchmark_refuses_a_submission(
    submission: Path, tmp_path: Path, change: Callable[[dict[str, Any]], Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        read_submission(damage(submission, tmp_path / "bad.json", change))


def test_benchmark_checks_what_a_submission_claims(submission: Path, tmp_path: Path) -> None:
    def claim(content: dict[str, Any]) -> None:
        apart = next(one for one in content["rollouts"] if one["outcome"] <= 0)
        apart["outcome"] = 1

    with pytest.raises(InputError, match="claims that the goal was reached"):
        read_submission(damage(submission, tmp_path / "bad.json", claim))

    def leave_out(content: dict[str, Any]) -> None:
        content["rollouts"] = [one for one in content["rollouts"] if one["demo"] != 4]
        content["episodes"] = len(content["rollouts"])

    with pytest.raises(InputError, match="no rollout is from test episode 4"):
        read_submission(damage(submission, tmp_path / "bad.json", leave_out))
