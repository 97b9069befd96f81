"""What a learner makes of environments that are wrapped, or of other packages."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.classic_control import CartPoleEnv
from refusals import refuses
from stable_baselines3.common.vec_env import VecEnvWrapper, VecFrameStack, VecNormalize

import animarl_envs
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.checkpoint import load_checkpoint, save_checkpoint
from animarl_algos.recipes.registry import DQCIL, DQDIL, DQN
from animarl_envs.wrappers import ConditionFlag, DTWReward

assert animarl_envs  # registers the ids

FEW: dict[str, Any] = {
    "gradient_steps": 1, "train_freq": (4, "step"), "buffer_size": 1000, "seed": 1, "device": "cpu",
    "policy_kwargs": {"hidden": 6}, "learning_starts": 10**9,
}  # fmt: skip


class Pays(VecEnvWrapper):
    """Pays 100 for every step."""

    def reset(self) -> Any:
        return self.venv.reset()

    def step_wait(self) -> Any:
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, np.full_like(rewards, 100.0), dones, infos


class Says(gym.Wrapper[Any, Any, Any, Any]):
    """Has names in its infos that AnimaRL's environments have too, and an attribute."""

    feedback = True

    def step(self, action: Any) -> Any:
        *rest, info = self.env.step(action)
        words = {"task_reward": -7.0, "executed": True, "warmup": True, "condition": 1}
        return *rest, info | words


def stored(model: Any) -> Any:
    return model.replay_buffer.frames


def paid_alike(env: Any) -> Any:
    return gym.wrappers.TransformReward(env, lambda _: 100.0)


@pytest.mark.parametrize(
    "env",
    [
        lambda: Pays(SlotVecEnv("agent", 2)),
        lambda: paid_alike(gym.make("AnimaRL/Agent-v0")),
        lambda: paid_alike(DTWReward(gym.make("AnimaRL/Agent-v0"))),
    ],
)
def test_the_reward_of_a_step_is_learned_from(env: Any) -> None:
    rewards = stored(DQN("MlpPolicy", env(), **FEW).learn(300)).rewards
    assert set(np.unique(rewards)) == {0.0, 100.0}  # 0: the step that an episode does not have


def test_names_of_another_package_mean_nothing() -> None:
    frames = [
        stored(DQN("MlpPolicy", wrap(gym.make("CartPole-v1")), **FEW).learn(300))
        for wrap in (lambda env: env, Says)
    ]
    for name in ("rewards", "actions", "warmup"):
        np.testing.assert_array_equal(*(getattr(one, name) for one in frames))


@pytest.mark.parametrize(
    "env",
    [
        lambda: Pays(SlotVecEnv("agent", 2)),
        lambda: paid_alike(DTWReward(gym.make("AnimaRL/Agent-v0"))),
    ],
)
def test_a_recipe_that_shapes_the_reward_refuses_one_that_a_wrapper_changed(env: Any) -> None:
    refuses("a wrapper changed it", DQDIL("MlpPolicy", env(), **FEW).learn, 10)


def test_two_weights_of_the_distance_are_refused() -> None:
    env = DTWReward(gym.make("AnimaRL/Agent-v0"), alpha=50.0)
    sentence = "alpha is 50.0 of the environment's DTW reward and 1.0 of the learner"
    refuses(sentence, DQDIL, "MlpPolicy", env, **FEW)
    DQDIL("MlpPolicy", env, **FEW, alpha=50.0).learn(20)


def flagged() -> Any:
    return ConditionFlag(DTWReward(gym.make("AnimaRL/Agent-v0")))


@pytest.mark.parametrize(
    "env",
    [
        lambda: VecFrameStack(SlotVecEnv("agent", 2, condition_flag=True), 2),
        lambda: gym.wrappers.TimeAwareObservation(flagged()),
    ],
)
def test_a_condition_flag_that_is_not_the_last_component_is_refused(env: Any) -> None:
    refuses("put the condition flag outermost", DQCIL, "MlpPolicy", env(), **FEW)
    DQCIL("MlpPolicy", gym.wrappers.TimeLimit(flagged(), 10), **FEW).learn(20)


def test_running_episodes_in_a_wrapper_with_a_state_of_its_own_begin_anew(tmp_path: Path) -> None:
    models = [
        DQN("MlpPolicy", wrap(SlotVecEnv("agent", 2)), **FEW).learn(20)
        for wrap in (lambda env: env, lambda env: VecFrameStack(env, 3))
    ]
    for model, goes_on in zip(models, (True, False), strict=True):
        save_checkpoint(model, tmp_path)
        load_checkpoint(model, tmp_path)
        assert (model._last_obs is not None) is goes_on
        model.learn(20, reset_num_timesteps=False)


@pytest.mark.parametrize("seconds", [0.5, 5.0])
def test_a_time_limit_of_another_package_may_be_in_seconds(seconds: float) -> None:
    class Seconds(CartPoleEnv):
        time_limit = seconds

    model = DQN("MlpPolicy", gym.wrappers.TimeLimit(Seconds(), 20), **FEW).learn(60)
    assert model.episode_limit == 20
    refuses("does not say how long", DQN, "MlpPolicy", Seconds(), **FEW)


def test_only_what_a_normaliser_changes_is_refused() -> None:
    def normalised(**what: bool) -> VecNormalize:
        return VecNormalize(SlotVecEnv("agent", 2), **what)

    DQN("MlpPolicy", normalised(norm_obs=False, norm_reward=False), **FEW).learn(20)
    refuses("norm_reward=False", DQN, "MlpPolicy", normalised(norm_obs=False), **FEW)
    refuses("standardise_inputs=True", DQN, "MlpPolicy", normalised(norm_reward=False), **FEW)
