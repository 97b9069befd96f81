"""Warm-up: a policy remembers the actions that were executed, not those that it asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.data.focal import FocalPolicy
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.recipes.dqn import DQN
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import NEWT
from animarl_envs.worlds import make_world
from animarl_envs.worlds.executed import ExecutedActions

NEWTS = load_packaged("newt").select(episodes=np.arange(6))
SHOWN = demonstrated_actions(NEWTS, NEWT.locomotion)


def test_a_world_executes_what_was_demonstrated_then_what_is_asked() -> None:
    world = make_world(make_scenario(NEWT, demos=NEWTS, split=None), 3)
    executed = ExecutedActions(world)
    world.reset(demo=np.array([4, 0, 2]))
    asked = np.full((3, 3), 7)
    for t in range(NEWT.warmup):
        expected = SHOWN[NEWTS.offsets[world.demo] + t]
        np.testing.assert_array_equal(executed(asked), expected)
        world.step(asked)
    assert executed(asked) is asked


def test_the_replay_memory_holds_executed_actions() -> None:
    env = SlotVecEnv(NEWT, 2, demos=NEWTS, dtw=None, time_limit=20)
    model = DQN("GruPolicy", env, seed=0, buffer_size=4000, learning_starts=10**6)
    model.learn(240)
    assert model.replay_buffer is not None
    frames, shown = model.replay_buffer.ring.frames, env.scenario.demos
    assert shown is not None
    inferred = demonstrated_actions(shown, NEWT.locomotion)
    held = {tuple(row) for row in frames.actions[frames.warmup].tolist()}
    possible = {
        tuple(row)
        for first in shown.offsets[:-1]
        for row in inferred[first : first + NEWT.warmup].tolist()
    }
    assert held and held <= possible


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
