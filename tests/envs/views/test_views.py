"""What each view does of its own; test_registry.py compares them with one another."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from animarl_envs.errors import InputError
from animarl_envs.views import AnimalVectorEnv

pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.usefixtures("_garbage_collected"),
]


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


def test_gymnasiums_step_limit_holds_in_vectors_too() -> None:
    vector = gym.make_vec("AnimaRL/Fly-v0", num_envs=2, demos=None, max_episode_steps=4)
    vector.reset(seed=0)
    ends = [vector.step(np.full(2, 12))[3].all() for _ in range(4)]
    assert ends == [False, False, False, True]
