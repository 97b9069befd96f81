"""``others="packaged"``: individuals that nobody controls act by the package's networks."""

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import animarl_envs
from animarl_algos.runs.pretrained import load_pretrained
from animarl_envs.errors import InputError
from animarl_envs.worlds.streams import draw_uniforms

COPIES, LIMIT = 3, 15


def test_packaged_opponents_act_as_their_network_does_on_what_they_see() -> None:
    """A parallel view that is given their actions shows what all of them see."""
    single: Any = gym.make("AnimaRL/Fly-v0", others="packaged").unwrapped
    everyone, policy = animarl_envs.parallel_env("Fly"), load_pretrained("fly").policy
    rest, steps = [1, 2], 0
    for seed in range(4):
        single.reset(seed=seed)
        seen = everyone.reset(seed=seed)[0]
        while everyone.agents and steps < 10 * (seed + 1):
            draws = np.zeros(3)
            draw_uniforms(single.world.random_state.copy(), draws[None, rest[0] :])
            values, *_ = policy.advance(np.stack(list(seen.values())), None, None)
            expected = policy.acting.choose(values, draws, 3)
            single.step(0)
            assert single._actions[0, rest].tolist() == expected[rest].tolist()
            seen = everyone.step(dict(zip(everyone.agents, single._actions[0].tolist())))[0]
            steps += 1
    assert steps > 20


def test_packaged_opponents_of_a_copy_are_those_of_a_single_environment() -> None:
    """In a task that shows its learner other inputs than its opponents, over ends of episodes."""
    options: dict[str, Any] = {"others": "packaged", "time_limit": LIMIT}
    copies: Any = gym.make_vec("AnimaRL/AgentTask-v0", num_envs=COPIES, **options)
    views: Any = [gym.make("AnimaRL/AgentTask-v0", **options) for _ in range(COPIES)]
    rows = [view.reset(seed=5 + b)[0] for b, view in enumerate(views)]
    assert np.array_equal(copies.reset(seed=5)[0], rows)
    ended, rng = np.zeros(COPIES, dtype=bool), np.random.default_rng(0)
    chosen = set()
    for _ in range(2 * LIMIT):
        actions = rng.integers(13, size=COPIES)
        seen, reward, terminated, truncated, _ = copies.step(actions)
        for b, view in enumerate(views):
            if ended[b]:
                assert np.array_equal(view.reset()[0], seen[b])
                continue
            row, earned, over, cut, _ = view.step(actions[b])
            assert np.array_equal(row, seen[b])
            assert (earned, over, cut) == (reward[b], terminated[b], truncated[b])
        ended = terminated | truncated
        chosen |= set(copies.unwrapped._actions[:, 1].tolist())
    assert len(chosen) > 2
    twins = [copy.deepcopy(copies.unwrapped), pickle.loads(pickle.dumps(copies.unwrapped))]
    for _ in range(3):
        actions = rng.integers(13, size=COPIES)
        seen = copies.step(actions)[0]
        assert all(np.array_equal(twin.step(actions)[0], seen) for twin in twins)


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("Shoal", {}, "no network of shoal comes with the package, only of agent, fly, newt"),
        ("Silkmoth", {}, "others is 'packaged', but moth is alone: leave others out"),
        ("Fly", {"senses_past": True}, "leave these options out"),
        ("Agent", {"num_pursuers": 3, "start": "uniform"}, "leave these options out"),
        ("Agent", {"thrusts": 2}, "leave these options out"),
    ],
)
def test_packaged_opponents_that_do_not_exist(
    name: str, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        gym.make(f"AnimaRL/{name}-v0", others="packaged", **options)
