"""What each view does of its own; test_registry.py compares them with one another."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import animarl_envs
from animarl_envs.errors import InputError
from animarl_envs.views import AnimalVectorEnv
from animarl_envs.wrappers import (
    ConditionFlag,
    ConditionFlagVector,
)


@pytest.fixture(autouse=True)
def warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def single(name: str, **options: Any) -> gym.Env[Any, Any]:
    return gym.make(animarl_envs.environment_id(name), **options)


def test_same_step_hands_out_the_last_observation() -> None:
    vector = AnimalVectorEnv("agent", 8, autoreset_mode=AutoresetMode.SAME_STEP)
    waiting = AnimalVectorEnv("agent", 8)
    vector.reset(seed=0)
    waiting.reset(seed=0)
    for _ in range(40):
        actions = np.full(8, 6)
        one, two = vector.step(actions), waiting.step(actions)
        over = one[2] | one[3]
        for b in np.flatnonzero(over):
            assert np.array_equal(one[4]["final_obs"][b], two[0][b])
            assert one[4]["final_info"]["outcome"][b] == two[4]["outcome"][b]
        if over.any():
            return
    raise AssertionError("no episode ended")


def test_disabled_autoreset_wants_a_mask() -> None:
    vector = AnimalVectorEnv("agent", 4, autoreset_mode="Disabled", time_limit=3)
    vector.reset(seed=0)
    for _ in range(3):
        ended = vector.step(np.full(4, 12))
    over = ended[2] | ended[3]
    assert over.all()
    with pytest.raises(InputError, match="reset"):
        vector.step(np.full(4, 12))
    vector.reset(options={"reset_mask": over})
    vector.step(np.full(4, 12))


@pytest.mark.parametrize("cue", ["actual", "flipped", 0, 1])
def test_the_cue_changes_the_flag_and_not_the_world(cue: Any) -> None:
    plain = gym.make_vec("AnimaRL/Agent-v0", num_envs=20)
    flagged = ConditionFlagVector(gym.make_vec("AnimaRL/Agent-v0", num_envs=20), cue=cue)
    expected, infos = plain.reset(seed=1)
    observed, _ = flagged.reset(seed=1)
    condition = infos["condition"]
    told = {"actual": condition, "flipped": 1 - condition}.get(cue, np.full(20, cue))
    assert np.array_equal(observed[:, :-1], expected)
    assert np.array_equal(observed[:, -1], told)
    single_env = ConditionFlag(single("agent"), cue=cue)
    row, info = single_env.reset(seed=1)
    assert row[-1] == told[0] and info["condition"] == condition[0]


def test_gymnasiums_step_limit_holds_in_vectors_too() -> None:
    vector = gym.make_vec("AnimaRL/Fly-v0", num_envs=2, demos=None, max_episode_steps=4)
    vector.reset(seed=0)
    ends = [vector.step(np.full(2, 12))[3].all() for _ in range(4)]
    assert ends == [False, False, False, True]
