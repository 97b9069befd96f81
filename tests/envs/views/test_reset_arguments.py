"""What ``reset`` takes: seeds of any size, one per copy, and options that exist."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refuses

import animarl_envs
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs.wrappers import DTWReward

HUGE = 2**200


def make_all() -> list[Any]:
    return [
        gym.make("AnimaRL/Agent-v0"),
        gym.make_vec("AnimaRL/Agent-v0", 3),
        animarl_envs.parallel_env("agent"),
    ]


def first(result: Any) -> Any:
    observation = result[0]
    return np.stack(list(observation.values())) if isinstance(observation, dict) else observation


@pytest.mark.parametrize("env", make_all(), ids=["single", "vector", "parallel"])
def test_seeds_of_any_size_start_streams_of_their_own(env: Any) -> None:
    same = first(env.reset(seed=HUGE)), first(env.reset(seed=HUGE))
    np.testing.assert_array_equal(*same)
    assert not np.array_equal(same[0], first(env.reset(seed=HUGE + 1)))


@pytest.mark.parametrize("env", make_all()[:2], ids=["single", "vector"])
@pytest.mark.parametrize("options", [3, {"demos": 0}, ["demo"]])
def test_options_that_do_not_exist_are_refused_by_name(env: Any, options: Any) -> None:
    refuses("demo", env.reset, options=options)


def test_the_parallel_view_warns_of_unknown_options() -> None:
    """PettingZoo's own tests give one that nobody knows."""
    env = animarl_envs.parallel_env("agent")
    with pytest.warns(UserWarning, match="no option 'demos': it knows demo"):
        env.reset(options={"demos": 0})
    refuses("give a dictionary", env.reset, options=3)


def test_a_copy_without_a_seed_goes_on_with_its_stream() -> None:
    env, other = gym.make_vec("AnimaRL/Agent-v0", 3), gym.make_vec("AnimaRL/Agent-v0", 3)
    env.reset(seed=[1, 5, 2])
    other.reset(seed=[7, 5, 8])
    one, two = env.reset(seed=[1, None, 2])[0], other.reset(seed=[1, None, 2])[0]
    np.testing.assert_array_equal(one, two)  # the middle one goes on from 5 in both
    np.testing.assert_array_equal(one[[0, 2]], other.reset(seed=[1, 9, 2])[0][[0, 2]])
    refuses("2 seeds: give 3", env.reset, seed=[1, 2])


def test_strangers_have_no_spaces() -> None:
    env = animarl_envs.parallel_env("agent")
    for space in (env.observation_space, env.action_space):
        refuses("no individual 'ghost': choose one of predator_0", space, "ghost")


def test_neighbouring_training_seeds_share_no_stream() -> None:
    streams = []
    for seed in range(4):
        env = SlotVecEnv("agent", 16)
        env.seed(seed)
        env.reset()
        streams.append(env.world.random_state.copy())
    assert len(np.unique(np.concatenate(streams))) == 4 * 16


def test_a_second_dtw_reward_is_refused() -> None:
    env = DTWReward(gym.make("AnimaRL/Agent-v0"))
    refuses("already", DTWReward, env)
