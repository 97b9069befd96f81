"""The three views of every registered species: the libraries' own checks, and one another."""

from __future__ import annotations

import copy
import hashlib
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pettingzoo.test import parallel_api_test, parallel_seed_test

import animarl_envs
from animarl_envs.errors import InputError
from animarl_envs.species import SPECIES
from animarl_envs.views import AnimalVectorEnv
from animarl_envs.wrappers import (
    ConditionFlag,
    ConditionFlagParallel,
    ConditionFlagVector,
    DTWReward,
)

NAMES = tuple(SPECIES)


@pytest.fixture(autouse=True)
def warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def single(name: str, **options: Any) -> gym.Env[Any, Any]:
    return gym.make(animarl_envs.environment_id(name), **options)


def conditions(name: str) -> tuple[Any, ...]:
    return (0, 1, "demo") if SPECIES[name].conditions else ("demo",)


@pytest.mark.parametrize("name", NAMES)
def test_registry_single_passes_the_libraries_checks(name: str) -> None:
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    for condition in conditions(name):
        env = single(name, condition=condition)
        check_env(env.unwrapped, skip_render_check=True)
        sb3_check_env(env.unwrapped)


@pytest.mark.parametrize("wrapper", [DTWReward, ConditionFlag])
def test_registry_wrapped_passes_the_checks(wrapper: Any) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*different from the unwrapped version")
        check_env(wrapper(single("agent").unwrapped), skip_render_check=True)


@pytest.mark.parametrize("name", NAMES)
def test_registry_parallel_passes_the_libraries_checks(name: str) -> None:
    parallel_api_test(animarl_envs.parallel_env(name), num_cycles=200)
    parallel_seed_test(lambda: animarl_envs.parallel_env(name), num_cycles=100)


def test_registry_parallel_with_the_flag_passes_the_checks() -> None:
    parallel_api_test(ConditionFlagParallel(animarl_envs.parallel_env("agent")), num_cycles=100)


@pytest.mark.parametrize("name", NAMES)
def test_registry_vector_equals_singles(name: str) -> None:
    copies = 5
    vector = gym.make_vec(animarl_envs.environment_id(name), num_envs=copies)
    views = [single(name) for _ in range(copies)]
    rng = np.random.default_rng(0)
    observations = vector.reset(seed=20)[0]
    assert np.array_equal(observations, [v.reset(seed=20 + b)[0] for b, v in enumerate(views)])
    ended = np.zeros(copies, dtype=bool)
    for _ in range(250):
        actions = rng.integers(13, size=copies)
        observations, rewards, terminated, truncated, _ = vector.step(actions)
        for b, view in enumerate(views):
            if ended[b]:
                row, reward, over, cut = view.reset()[0], 0.0, False, False
            else:
                row, reward, over, cut, _ = view.step(actions[b])
            assert np.array_equal(row, observations[b])
            assert (reward, over, cut) == (rewards[b], terminated[b], truncated[b])
        ended = terminated | truncated


@pytest.mark.parametrize("name", NAMES)
def test_registry_copies_continue_identically(name: str) -> None:
    env = single(name)
    env.reset(seed=4)
    for _ in range(5):
        env.step(3)
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for action in (0, 12, 7):
        expected = env.step(action)
        for twin in twins:
            got = twin.step(action)
            assert np.array_equal(got[0], expected[0]) and got[1:4] == expected[1:4]


@pytest.mark.parametrize("name", NAMES)
def test_registry_observations_share_no_memory(name: str) -> None:
    env = single(name)
    first, _ = env.reset(seed=0)
    kept = first.copy()
    second = env.step(0)[0]
    assert not np.shares_memory(first, second) and np.array_equal(first, kept)
    vector = gym.make_vec(animarl_envs.environment_id(name), num_envs=3)
    first, _ = vector.reset(seed=0)
    assert not np.shares_memory(first, vector.step(np.zeros(3, dtype=int))[0])


def test_registry_spec_round_trip() -> None:
    env = single("agent", contact_radius=0.15, locomotion={"prey": 1.2}, condition=1)
    assert env.spec is not None
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert np.array_equal(env.reset(seed=3)[0], again.reset(seed=3)[0])
    info = again.reset(seed=3)[1]
    assert info["scenario"]["contact_radius"] == 0.15
    assert info["condition"] == 1


PROGRAM = """
import hashlib, gymnasium as gym, animarl_envs
v = gym.make_vec("AnimaRL/Agent-v0", num_envs=7)
h = hashlib.sha256(v.reset(seed=11)[0].tobytes())
for k in range(100):
    o, r, *_ = v.step([(k + b) % 13 for b in range(7)])
    h.update(o.tobytes() + r.tobytes())
print(h.hexdigest())
"""


def test_same_seed_same_bytes_in_another_process() -> None:
    vector = gym.make_vec("AnimaRL/Agent-v0", num_envs=7)
    digest = hashlib.sha256(vector.reset(seed=11)[0].tobytes())
    for k in range(100):
        observations, rewards, *_ = vector.step(np.array([(k + b) % 13 for b in range(7)]))
        digest.update(observations.tobytes() + rewards.tobytes())
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == digest.hexdigest()


def test_importing_the_environments_imports_no_learner() -> None:
    program = (
        "import sys, animarl_envs; print([m for m in ('torch', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_parallel_view_moves_as_the_single_one_with_policies() -> None:
    rng = np.random.default_rng(0)
    plan = rng.integers(13, size=(60, 3))
    at = {"t": 0}
    others = {
        "predator_1": lambda o: np.full(len(o), plan[at["t"], 1]),
        "prey": lambda o: np.full(len(o), plan[at["t"], 2]),
    }
    env = single("agent", others=others)
    everyone = animarl_envs.parallel_env("agent")
    assert np.array_equal(env.reset(seed=2)[0], everyone.reset(seed=2)[0]["predator_0"])
    for t in range(60):
        at["t"] = t
        row, reward, over, cut, _ = env.step(plan[t, 0])
        rows, rewards, overs, _, _ = everyone.step(dict(zip(everyone.agents, plan[t].tolist())))
        assert np.array_equal(row, rows["predator_0"])
        assert (reward, over) == (rewards["predator_0"], overs["predator_0"])
        if over or cut:
            break


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


def test_a_flag_needs_a_species_with_conditions() -> None:
    with pytest.raises(InputError, match="no experimental conditions"):
        ConditionFlag(single("fly"))


def test_actions_and_order_are_checked_in_every_view() -> None:
    env = single("agent", disable_env_checker=True).unwrapped
    with pytest.raises(InputError, match="before reset"):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(InputError, match="0 to 12"):
        env.step(13)
    vector = gym.make_vec("AnimaRL/Agent-v0", num_envs=2)
    with pytest.raises(InputError, match="before reset"):
        vector.step(np.zeros(2, dtype=int))
    vector.reset(seed=0)
    for bad in ([0, 13], [-1, 0], [0], [0.5, 1.0]):
        with pytest.raises(InputError):
            vector.step(np.array(bad))
    everyone = animarl_envs.parallel_env("agent")
    with pytest.raises(InputError, match="before reset"):
        everyone.step({})
    everyone.reset(seed=0)
    with pytest.raises(InputError, match="no action for"):
        everyone.step({"prey": 0})
    with pytest.raises(InputError, match="out of range"):
        everyone.step(dict.fromkeys(everyone.agents, 13))
