"""Warm-up: a policy remembers the actions that were executed, not those that it asked for."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from animarl_algos.data.vec_env import FocalPolicy, SlotVecEnv
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.learner.callbacks import evaluate_individuals
from animarl_algos.recipes.registry import DQN
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import NEWT
from animarl_envs.views.parallel import AnimalParallelEnv
from animarl_envs.views.single import AnimalEnv
from animarl_envs.views.vector import AnimalVectorEnv
from animarl_envs.worlds import make_world

NEWTS = load_packaged("newt").select(episodes=np.arange(6))
SHOWN = demonstrated_actions(NEWTS, NEWT.locomotion)


def test_a_world_executes_what_was_demonstrated_then_what_is_asked() -> None:
    world = make_world(make_scenario(NEWT, demos=NEWTS, split=None), 3)
    world.reset(demo=np.array([4, 0, 2]))
    asked = np.full((3, 3), 7)
    for t in range(NEWT.warmup):
        expected = SHOWN[NEWTS.offsets[world.demo] + t]
        np.testing.assert_array_equal(world.executed(asked), expected)
        world.step(asked)
    assert world.executed(asked) is asked


def warm_up_rows(demos: Any) -> set[tuple[int, ...]]:
    """What all individuals did in some step of a warm-up."""
    inferred = demonstrated_actions(demos, NEWT.locomotion)
    starts = demos.offsets[:-1]
    return {tuple(row) for s in starts for row in inferred[s : s + NEWT.warmup].tolist()}


def test_the_replay_memory_holds_executed_actions() -> None:
    env = SlotVecEnv(NEWT, 2, demos=NEWTS, dtw=None, time_limit=20)
    model = DQN("GruPolicy", env, seed=0, buffer_size=4000, learning_starts=10**6)
    model.learn(240)
    assert model.replay_buffer is not None
    frames, shown = model.replay_buffer.frames, env.scenario.demos
    assert shown is not None
    held = {tuple(row) for row in frames.actions[frames.warmup].tolist()}
    assert held and held <= warm_up_rows(shown)


class Echo:
    """Asks for one action and keeps what it is told was executed."""

    observation_space = action_space = None

    def __init__(self) -> None:
        self.told: list[NDArray[np.integer]] = []

    def predict(
        self, observation: NDArray[Any], state: Any = None, *_: Any, **__: Any
    ) -> tuple[NDArray[np.int64], Any]:
        return np.full(len(observation), 5), ("before",)

    def remember(self, state: Any, executed: NDArray[np.integer]) -> Any:
        self.told.append(executed)
        return state


def test_rollouts_tell_a_policy_what_was_executed() -> None:
    scenario = make_scenario(NEWT, demos=NEWTS, split=None)
    echo, alone = Echo(), Echo()
    for policy in (echo, FocalPolicy(alone, NEWTS.individuals, NEWTS.individuals[1])):
        collect_rollouts(
            lambda n: make_world(scenario, n), policy, method="echo", seed=0, repetitions=1
        )
    steps = NEWT.warmup
    for told, individuals in ((echo.told, slice(None)), (alone.told, slice(1, 2))):
        assert len(told) == steps
        frames = NEWTS.offsets[:-1] + np.arange(steps)[:, None]
        expected = SHOWN[frames][:, :, individuals].reshape(steps, -1)
        np.testing.assert_array_equal(np.stack(told), expected)


def test_all_views_say_what_was_executed() -> None:
    demo = 4
    shown = SHOWN[NEWTS.offsets[demo] :][: NEWT.warmup]
    options: dict[str, Any] = {"demos": NEWTS, "split": None}
    newt = NEWTS.individuals[1]
    single = AnimalEnv(NEWT, focal=newt, **options)
    several = AnimalVectorEnv(NEWT, 2, focal=newt, **options)
    everyone = AnimalParallelEnv(NEWT, **options)
    for env in (single, several, everyone):
        env.reset(seed=0, options={"demo": demo})
    for t in range(NEWT.warmup + 1):
        expected = shown[t] if t < NEWT.warmup else np.full(3, 7)
        assert single.step(7)[4]["executed"] == expected[1]
        assert several.step(np.array([7, 7]))[4]["executed"].tolist() == [expected[1]] * 2
        infos = everyone.step(dict.fromkeys(NEWTS.individuals, 7))[4]
        assert [info["executed"] for info in infos.values()] == expected.tolist()


def test_a_learner_in_a_single_environment_holds_what_was_executed() -> None:
    env = AnimalEnv(NEWT, focal=NEWTS.individuals[1], demos=NEWTS, split=None)
    model = DQN("GruPolicy", env, seed=0, buffer_size=4000, learning_starts=10**6, device="cpu")
    model.learn(NEWT.warmup)
    assert model.replay_buffer is not None
    staged = model.replay_buffer.staged.actions.ravel()[: NEWT.warmup]
    first = NEWTS.offsets[env.world.demo.item()]
    assert staged.tolist() == SHOWN[first : first + NEWT.warmup, 1].tolist()


def test_an_evaluation_tells_a_policy_what_was_executed(monkeypatch: pytest.MonkeyPatch) -> None:
    env = SlotVecEnv(NEWT, 2, demos=NEWTS, dtw=None, time_limit=20)
    model = DQN("GruPolicy", env, seed=0, buffer_size=4000, device="cpu")
    told = []
    kept = model.policy.remember
    monkeypatch.setattr(
        model.policy, "remember", lambda state, done: told.append(done) or kept(state, done)
    )
    evaluate_individuals(model, env, 2)
    first_steps = np.stack(told[: NEWT.warmup]).reshape(-1, 3).tolist()
    assert {tuple(row) for row in first_steps} <= warm_up_rows(env.scenario.demos)
