"""Wrappers beside what they wrap: the world is not changed, only what is paid and told."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import animarl_envs
from animarl_envs.errors import InputError
from animarl_envs.wrappers import (
    ConditionFlag,
    ConditionFlagParallel,
    ConditionFlagVector,
    DTWReward,
    DTWRewardParallel,
    DTWRewardVector,
)


def agent(**options: Any) -> Any:
    return gym.make("AnimaRL/Agent-v0", **options)


def test_the_shaped_reward_is_the_task_reward_less_the_weighted_penalty() -> None:
    plain, shaped = agent(), DTWReward(agent(), alpha=0.3)
    plain.reset(seed=5)
    shaped.reset(seed=5)
    total, ended = 0.0, False
    actions = np.random.default_rng(0)
    while not ended:
        action = int(actions.integers(13))
        observation, reward, *ends, _ = plain.step(action)
        same, paid, *same_ends, info = shaped.step(action)
        np.testing.assert_array_equal(observation, same)
        assert ends == same_ends
        assert info["task_reward"] == reward
        assert paid == pytest.approx(reward - 0.3 * info["dtw_penalty"], abs=1e-12)
        total += info["dtw_penalty"]
        ended = any(ends)
    assert total > 0.0


@pytest.mark.parametrize("penalty", ["increment", "cumulative"])
def test_vector_and_single_pay_the_same(penalty: str) -> None:
    vector = DTWRewardVector(gym.make_vec("AnimaRL/Agent-v0", num_envs=3), penalty=penalty)
    singles = [DTWReward(agent(), penalty=penalty) for _ in range(3)]
    vector.reset(seed=7)
    for b, env in enumerate(singles):
        env.reset(seed=7 + b)
    running = np.ones(3, dtype=bool)
    for t in range(40):
        actions = np.array([t % 13, (t + 4) % 13, 12])
        _, rewards, terminated, truncated, _ = vector.step(actions)
        for b in np.flatnonzero(running).tolist():
            _, reward, *_ = singles[b].step(int(actions[b]))
            assert rewards[b] == pytest.approx(reward, abs=1e-12)
        running &= ~(terminated | truncated)
    assert running.any()


def test_a_wrapped_env_continues_identically_after_a_deep_copy() -> None:
    env = DTWReward(ConditionFlag(agent()))
    env.reset(seed=2)
    for _ in range(3):
        env.step(3)
    twin = copy.deepcopy(env)
    for action in (0, 5, 12):
        one, other = env.step(action), twin.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]


def test_the_flag_is_the_last_component_and_the_rest_is_untouched() -> None:
    vector = gym.make_vec("AnimaRL/Agent-v0", num_envs=16)
    flagged = ConditionFlagVector(gym.make_vec("AnimaRL/Agent-v0", num_envs=16))
    plain, info = vector.reset(seed=0)
    told, _ = flagged.reset(seed=0)
    np.testing.assert_array_equal(told[:, :-1], plain)
    np.testing.assert_array_equal(told[:, -1], info["condition"])
    assert set(info["condition"]) == {0, 1}
    assert flagged.observation_space.contains(told)


VIEWS: dict[str, tuple[Any, Any, Any]] = {
    "single": (lambda name, **o: gym.make(name, **o), DTWReward, ConditionFlag),
    "vector": (
        lambda name, **o: gym.make_vec(name, num_envs=2, **o), DTWRewardVector, ConditionFlagVector
    ),
    "parallel": (
        lambda name, **o: animarl_envs.parallel_env(name[8:-3].lower(), **o),
        DTWRewardParallel, ConditionFlagParallel,
    ),
}  # fmt: skip
every_view = pytest.mark.parametrize("view", VIEWS)


@every_view
@pytest.mark.parametrize(
    ("which", "species", "options", "arguments", "says"),
    [
        (1, "Agent", {}, {"alpha": -1.0}, "alpha is -1.0"),
        (1, "Agent", {}, {"alpha": float("nan")}, "alpha is nan"),
        (1, "Agent", {}, {"alpha": "much"}, "alpha is 'much'"),
        (1, "Agent", {}, {"penalty": "total"}, "penalty"),
        (1, "Agent", {"demos": None}, {}, "demos="),
        (1, "Silkmoth", {"start": "uniform"}, {}, "demos="),
        (2, "Agent", {}, {"cue": "both"}, "cue is 'both'"),
        (2, "Agent", {}, {"cue": True}, "cue is True"),
        (2, "Fly", {}, {}, "fly has no experimental conditions"),
        (2, "Newt", {"demos": None}, {}, "newt has no experimental conditions"),
    ],
)
def test_a_wrapper_that_does_not_fit_is_refused(
    view: str, which: int, species: str, options: Any, arguments: Any, says: str
) -> None:
    env = VIEWS[view][0](f"AnimaRL/{species}-v0", **options)
    with pytest.raises(InputError) as refusal:
        VIEWS[view][which](env, **arguments)
    assert says in str(refusal.value)


@pytest.mark.parametrize("wrapper", [DTWReward, ConditionFlag])
@pytest.mark.parametrize("wrapper_of_many", [DTWRewardVector, ConditionFlagVector])
def test_other_peoples_environments_are_refused(wrapper: Any, wrapper_of_many: Any) -> None:
    with pytest.raises(InputError, match="AnimaRL"):
        wrapper(gym.make("CartPole-v1"))
    with pytest.raises(InputError, match="AnimaRL"):
        wrapper_of_many(gym.make_vec("CartPole-v1", num_envs=2))


@pytest.mark.parametrize(("condition", "paid"), [(0, 0.0), (1, 1.0)])
@pytest.mark.parametrize("cue", [0, 1, "flipped"])
def test_the_world_changes_without_the_cue(condition: int, paid: float, cue: Any) -> None:
    """Who is paid for a capture follows the world's condition, whatever is told."""
    start = [[0.45, 0.0], [0.0, 0.4], [0.54, 0.0]]
    env = ConditionFlagParallel(
        animarl_envs.parallel_env("agent", demos=None, start=start, condition=condition), cue=cue
    )
    observations, _ = env.reset(seed=0)
    told = {"flipped": 1 - condition}.get(cue, cue)
    assert {row[-1] for row in observations.values()} == {told}
    _, rewards, terminated, _, infos = env.step({"predator_0": 0, "predator_1": 12, "prey": 12})
    assert terminated["prey"]
    assert (rewards["predator_0"], rewards["predator_1"]) == (1.0, paid)
    assert infos["prey"]["condition"] == condition
