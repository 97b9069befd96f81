"""Others' methods and submissions in the benchmark: what is asked of them, and what is refused."""

import importlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from refusals import refuses
from small_runs import few

from animarl_algos.benchmark.matrix import Matrix, plan
from animarl_algos.benchmark.methods import (
    NEIGHBOURS,
    SEGMENT,
    CheckedPolicy,
    MethodSetting,
    NearestSegment,
    Steering,
    errors_as_input_errors,
    expert_rollouts,
    parameters_of,
    parse_method,
    recordings_of_other_starts,
    source_of,
)
from animarl_algos.benchmark.pieces import attempt
from animarl_algos.benchmark.scores import Score, ranked
from animarl_algos.evaluation.collect import RandomPolicy
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner.callbacks import TERMINATED
from animarl_algos.runs.run import Run
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.locomotion import COAST
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, get_species
from animarl_envs.worlds import demonstration_observations, make_world

HERE = "test_benchmark_methods"


def make_raising(setting: MethodSetting) -> Callable[[Any], Any]:
    """A factory, as somebody might write one."""
    assert "test" not in setting.demos.split

    def act(observation: Any) -> Any:
        return 1 // 0

    return act


def make_ending(setting: MethodSetting) -> Callable[[Any], Any]:
    """Another, whose method ends the process; named in ``test_benchmark.py``."""

    def act(observation: Any) -> Any:
        raise SystemExit(0)

    return act


def make_dying(setting: MethodSetting) -> Any:
    """Its process dies, as for lack of memory."""
    os._exit(1)


def make_nothing(setting: MethodSetting) -> Any:
    raise ValueError("bad\n\n## fly2\nsecond")


def test_benchmark_asks_predict_or_a_callable() -> None:
    seen = np.zeros((3, 2), dtype=np.float32)
    by_call = CheckedPolicy("mine", lambda observation: np.full(len(observation), 2.0), 13)
    assert by_call.predict(seen)[0].tolist() == [2, 2, 2]
    assert CheckedPolicy("mine", RandomPolicy(0), 13).predict(seen)[0].shape == (3,)
    refuses("no predict", CheckedPolicy, "mine", 3, 13)
    with pytest.raises(InputError, match="method mine: its predict raised ValueError"):
        CheckedPolicy("mine", lambda _: [[1], [1, 2], 3], 13).predict(seen)
    network = torch.nn.Linear(3, 2)
    assert parameters_of(network) == parameters_of(SimpleNamespace(policy=network)) == 3 * 2 + 2
    assert parameters_of(len) is None


def test_benchmark_lets_signals_through_somebody_elses_code() -> None:
    for ending in (SystemExit(TERMINATED), KeyboardInterrupt()):
        with pytest.raises(type(ending)), errors_as_input_errors("it raised"):
            raise ending
    said = r"it raised SystemExit \(3\): fix it"
    with pytest.raises(InputError, match=said), errors_as_input_errors("it raised"):
        raise SystemExit(3)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ([0, 1, 13], "gave action 13"), ([0, -1, 2], "gave action -1"),
        ([0, np.nan, 2], "gave action nan"), ([0, 0.5, 2], r"gave action 0\.5"),
        ([0, 1], "of shape"), (["a", "b", "c"], "of shape"),
    ],
)  # fmt: skip
def test_benchmark_refuses_actions(answer: Any, said: str) -> None:
    refuses(said, CheckedPolicy("mine", lambda _: np.array(answer), 13).predict, np.zeros((3, 2)))


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
        refuses(said, parse_method, given)


def test_benchmark_hands_methods_no_test_episode(tmp_path: Path) -> None:
    """A world of other test episodes gives a method the same to train on, in every field."""
    clean = few()
    rng = np.random.default_rng(0)
    bad = np.repeat(clean.split == "test", clean.lengths)
    positions = clean.positions.copy()
    positions[bad] = rng.uniform(-0.9, 0.9, positions[bad].shape)
    settings = []
    for name, demos in (("clean", clean), ("poisoned", replace(clean, positions=positions))):
        world = replace(plan(FEW).worlds[0], data="agent", demos=demos)
        matrix = FEW.changed(species=("agent",), episodes={})
        world = replace(world, settings=matrix.world_settings("agent", demos))
        assert attempt(world, tmp_path / name) == ""
        settings.append(MethodSetting.of(Run(world.folder(tmp_path / name)), 0))
    first, second = settings
    assert set(first.demos.split) == {"train", "val"}
    assert first.demos.fingerprint() == second.demos.fingerprint()
    assert {k: v for k, v in vars(first).items() if k != "demos"} == {
        k: v for k, v in vars(second).items() if k != "demos"
    }
    seen = []
    for one in settings:
        env = one.environment()
        env.seed(0)
        seen.append(env.reset())
    assert np.array_equal(*seen)


EXAMPLES = Path(__file__).parents[3] / "examples" / "benchmark"
FEW = Matrix(
    species=("fly",), episodes={"train": 4, "val": 2, "test": 2}, repetitions=1, thrusts="1"
)


def rows_of(methods: dict[str, str], out: Path) -> dict[str, Rollouts]:
    """Rollouts of others' methods on few flies."""
    asked = plan(FEW, methods)
    assert attempt(asked.worlds[0], out) == ""
    made = [cell for cell in asked.cells if cell.kind == "method"]
    for cell in made:
        assert attempt(cell, out) == ""
    return {cell.method: cell.rollouts(out) for cell in made}


def test_benchmark_examples_learn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr(importlib.import_module("methods"), "STEPS", 1)
    monkeypatch.setattr("animarl_algos.benchmark.matrix.WORLD_COPIES", 2)
    names = {"ppo": "make_ppo", "rppo": "make_recurrent_ppo", "glide": "make_gliding"}
    made = rows_of({name: f"methods:{factory}" for name, factory in names.items()}, tmp_path)
    assert {name: one.method for name, one in made.items()} == {name: name for name in names}
    held = plan(FEW.changed(references=("constant-velocity",)))
    assert attempt(held.cells[0], tmp_path) == ""
    reference = held.cells[0].rollouts(tmp_path)  # the same by another road
    assert np.array_equal(made["glide"].positions, reference.positions)


def test_benchmark_takes_d3rlpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("d3rlpy")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example = importlib.import_module("d3rlpy_bc")
    monkeypatch.setattr(example, "STEPS", 300)
    made = rows_of({"d3rlpy": "d3rlpy_bc:make_discrete_bc"}, tmp_path)["d3rlpy"]
    setting = MethodSetting.of(plan(FEW).cells[0].world_run(tmp_path), 0)
    train = setting.demos.select(split="train")
    dataset = example.datasets(setting, train, flagged=False)[0]
    learner = example.clone(dataset, 300)
    seen = np.concatenate([one.observations for one in dataset.episodes])
    done = np.concatenate([one.actions for one in dataset.episodes]).ravel()
    most = np.bincount(done).max() / len(done)
    assert (learner.predict(seen) == done).mean() > most + 0.05  # it learned something
    assert len(made) == 2


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
    made = recordings_of_other_starts(others, test, 0)
    assert len(made) == len(others)
    assert (made.condition == test.condition[made.demo]).all()
    pairs = set(zip(made.demo.tolist(), made.repetition.tolist()))
    assert len(pairs) == len(made)
    counts = np.bincount(made.demo)
    for condition in (0, 1):
        there = counts[test.condition == condition]
        assert there.max() - there.min() <= 1


def test_benchmark_experts_begin_at_the_starts_of_their_condition() -> None:
    demos = load_packaged("agent")
    kept = [np.flatnonzero((demos.split == s) & (demos.condition == c))[:n]
            for s, n in (("train", 3), ("val", 1), ("test", 3)) for c in (0, 1)]  # fmt: skip
    some = demos.select(episodes=np.sort(np.concatenate(kept)))
    made = expert_rollouts(some, AGENT, seed=0, repetitions=2)
    test = some.select(split="test")
    assert (made.condition == test.condition[made.demo]).all()
    assert sorted(made.demo.tolist()) == sorted(list(range(6)) * 2)
    starts = np.stack([made.path(i)[0] for i in range(len(made))])
    assert np.allclose(starts, test.positions[test.offsets[made.demo]], atol=1e-3)
    with pytest.raises(InputError, match="leave 'experts' out"):
        expert_rollouts(load_packaged("fly"), get_species("fly"), seed=0, repetitions=1)
    asked = plan(Matrix(species=("agent", "fly"), references=("experts", "still")))
    cells = ["agent/experts/0", "agent/still/0", "fly/still/0"]
    assert [cell.name for cell in asked.cells] == cells


def test_benchmark_nearest_segment_is_looked_up_and_followed() -> None:
    demos, species = load_packaged("agent"), AGENT
    some = demos.select(episodes=np.flatnonzero(demos.split == "train")[:2])
    policy = NearestSegment(species, some, seed=0)
    seen = demonstration_observations(species, some).astype(np.float64)
    done = demonstrated_actions(some, species.locomotion)
    flag = np.full((3, 1), some.condition[0])
    going = np.flatnonzero(done[:, 0] >= 0)
    state, first = None, np.zeros(0)
    for t in range(round(SEGMENT / species.dt)):
        actions, state = policy.predict(np.concatenate([seen[20 + t], flag], axis=1), state)
        first = state[0] if t == 0 else first
        assert actions.tolist() == [done[frame, k] for k, frame in enumerate(state[0])]
        assert (state[0] == first + t).all()
    assert (state[1] == 1).all()  # the segment is over
    for k in range(3):
        own = seen[going, k]
        spread = own.std(axis=0)
        apart = np.linalg.norm(((own - seen[20, k]) / np.where(spread > 0, spread, 1)), axis=1)
        assert first[k] in going[np.argsort(apart)[:NEIGHBOURS]]
    with pytest.raises(InputError, match="no training episode is of condition"):
        policy.predict(np.concatenate([seen[0], 1 - flag], axis=1))


def test_benchmark_score_survives_json() -> None:
    row = {"measure": "auc", "value": 0.5, "null": 0.55, "p": np.nan, "inside": True}
    made = Score(
        method="x", seeds=(1,), starts=2, rollouts=4,
        measures=[row], energies=np.array([[0.5, np.nan]]),
    )  # fmt: skip
    again = Score.from_json(json.loads(json.dumps(made.to_json())))
    auc = again.by_measure["auc"]
    assert auc["inside"] and np.isnan(auc["p"])
    assert str(again.measures) == str(made.measures) and again.seeds == (1,)
    assert np.array_equal(again.energies, made.energies, equal_nan=True)


def test_benchmark_ranks_what_differs_by_more_than_rounding() -> None:
    drawn = np.random.default_rng(0).uniform(1.0, 2.0, 12)

    def score(method: str, energies: Any) -> Score:
        return Score(
            method=method, seeds=tuple(range(len(energies))), starts=12, rollouts=12,
            measures=pd.DataFrame(), energies=energies,
        )  # fmt: skip

    rounded = score("rounded", np.tile(drawn + 1e-14, (3, 1)))
    three = [score("same", drawn[None]), rounded, score("worse", drawn[None] + 0.1)]
    assert ranked(three, 200) == {"same": "1–2", "rounded": "1–2", "worse": "3"}
