"""Wrappers beside what they wrap: the world is not changed, only what is paid and told.

test_registry.py compares the views of every wrapped environment, test_dtw.py the penalty with the
definition.
"""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refuses

import animarl_envs
from animarl_envs.wrappers import (
    ConditionFlag,
    ConditionFlagParallel,
    ConditionFlagVector,
    DTWReward,
    DTWRewardParallel,
    DTWRewardVector,
)

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("_garbage_collected")]


def agent(**options: Any) -> Any:
    return gym.make("AnimaRL/Agent-v0", **options)


def test_the_order_of_the_wrappers_does_not_matter() -> None:
    one, other = DTWReward(ConditionFlag(agent())), ConditionFlag(DTWReward(agent()))
    np.testing.assert_array_equal(one.reset(seed=2)[0], other.reset(seed=2)[0])
    for action in (3, 3, 3, 0, 5, 12):
        (seen, *paid), (same, *same_paid) = one.step(action), other.step(action)
        np.testing.assert_array_equal(seen, same)
        assert paid == same_paid


@pytest.mark.parametrize("cue", ["actual", "flipped", 0, 1])
def test_the_cue_changes_the_flag_and_not_the_world(cue: Any) -> None:
    plain = gym.make_vec("AnimaRL/Agent-v0", num_envs=20)
    flagged = ConditionFlagVector(gym.make_vec("AnimaRL/Agent-v0", num_envs=20), cue=cue)
    expected, infos = plain.reset(seed=1)
    observed, _ = flagged.reset(seed=1)
    condition = infos["condition"]
    assert set(condition) == {0, 1}
    told = {"actual": condition, "flipped": 1 - condition}.get(cue, np.full(20, cue))
    assert np.array_equal(observed[:, :-1], expected)
    assert np.array_equal(observed[:, -1], told)
    single_env = ConditionFlag(agent(), cue=cue)
    row, info = single_env.reset(seed=1)
    assert row[-1] == told[0] and info["condition"] == condition[0]


VIEWS: dict[str, Any] = {
    "single": gym.make,
    "vector": lambda name, **options: gym.make_vec(name, num_envs=2, **options),
    "parallel": lambda name, **options: animarl_envs.parallel_env(name[8:-3].lower(), **options),
}
DTW = {"single": DTWReward, "vector": DTWRewardVector, "parallel": DTWRewardParallel}
FLAG = {"single": ConditionFlag, "vector": ConditionFlagVector, "parallel": ConditionFlagParallel}


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(
    ("wrappers", "species", "options", "arguments", "says"),
    [
        (DTW, "Agent", {}, {"alpha": -1.0}, "alpha is -1.0"),
        (DTW, "Agent", {}, {"alpha": float("nan")}, "alpha is nan"),
        (DTW, "Agent", {}, {"alpha": "much"}, "alpha is 'much'"),
        (DTW, "Agent", {}, {"penalty": "total"}, "penalty"),
        (DTW, "Agent", {"demos": None}, {}, "demos="),
        (DTW, "Silkmoth", {"start": "uniform"}, {}, "demos="),
        (FLAG, "Agent", {}, {"cue": "both"}, "cue is 'both'"),
        (FLAG, "Agent", {}, {"cue": True}, "cue is True"),
        (FLAG, "Fly", {}, {}, "fly has no experimental conditions"),
        (FLAG, "Newt", {"demos": None}, {}, "newt has no experimental conditions"),
    ],
)
def test_a_wrapper_that_does_not_fit_is_refused(
    view: str, wrappers: Any, species: str, options: Any, arguments: Any, says: str
) -> None:
    refuses(says, wrappers[view], VIEWS[view](f"AnimaRL/{species}-v0", **options), **arguments)


def test_other_peoples_environments_are_refused() -> None:
    for single, vector in ((DTWReward, DTWRewardVector), (ConditionFlag, ConditionFlagVector)):
        refuses("AnimaRL", single, gym.make("CartPole-v1"))
        refuses("AnimaRL", vector, gym.make_vec("CartPole-v1", num_envs=2))


@pytest.mark.parametrize(("condition", "paid"), [(0, 0.0), (1, 1.0)])
@pytest.mark.parametrize("cue", [0, 1, "flipped"])
def test_the_world_changes_without_the_cue(condition: int, paid: float, cue: Any) -> None:
    """Who is paid for a capture follows the world's condition, whatever is told."""
    start = [[0.45, 0.0], [0.0, 0.4], [0.54, 0.0]]
    options = {"start": start, "condition": condition, "recorded": True}
    plain = animarl_envs.parallel_env("agent", demos=None, **options)
    env = ConditionFlagParallel(plain, cue=cue)
    observations, _ = env.reset(seed=0)
    told = {"flipped": 1 - condition}.get(cue, cue)
    assert {row[-1] for row in observations.values()} == {told}
    _, rewards, terminated, _, infos = env.step({"predator_0": 0, "predator_1": 12, "prey": 12})
    assert terminated["prey"]
    assert (rewards["predator_0"], rewards["predator_1"]) == (1.0, paid)
    assert infos["prey"]["condition"] == condition
