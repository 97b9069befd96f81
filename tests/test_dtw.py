"""The DTW rows against a textbook DTW, an independent library, and through every view."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from textbook_dtw import closeness, textbook

import animarl_envs
from animarl_envs.dtw import WINDOW, dtw_distance
from animarl_envs.errors import InputError
from animarl_envs.views import AnimalVectorEnv
from animarl_envs.wrappers import DTWReward, DTWRewardParallel, DTWRewardVector


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 30))
def test_closed_end_equals_the_textbook(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 2)), rng.normal(size=(m, 2))
    assert dtw_distance(x, y) == pytest.approx(textbook(x, y)[-1, -1], abs=1e-9)


def test_closed_end_equals_an_independent_library() -> None:
    library = pytest.importorskip("dtaidistance.dtw_ndim")
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, y = rng.normal(size=(40, 2)), rng.normal(size=(55, 2))
        theirs = library.distance(x, y, inner_dist="euclidean")
        assert dtw_distance(x, y) == pytest.approx(theirs, abs=1e-9)


def test_a_path_has_no_distance_to_itself_nor_to_its_slow_twin() -> None:
    x = np.random.default_rng(0).normal(size=(20, 2))
    assert dtw_distance(x, x) == 0.0
    assert dtw_distance(np.repeat(x, 3, axis=0), x) == 0.0


def test_misshapen_paths_are_refused() -> None:
    with pytest.raises(InputError, match="shapes"):
        dtw_distance(np.zeros((3, 3)), np.zeros((3, 2)))


def test_single_view_pays_every_row_as_the_textbook_says() -> None:
    plain = gym.make("AnimaRL/Agent-v0", focal="predator_1")
    env = DTWReward(plain, alpha=0.5, penalty="increment")
    world = env.unwrapped.world  # type: ignore[attr-defined]
    rng = np.random.default_rng(3)
    for seed in range(5):
        _, info = env.reset(seed=seed)
        recorded = world.demos.episode(info["demo"]).positions[:, 1]
        path, paid = [world.position[0, 1].copy()], []
        done = False
        while not done:
            _, reward, terminated, truncated, info = env.step(int(rng.integers(13)))
            path.append(world.position[0, 1].copy())
            paid.append(info["dtw_penalty"])
            assert reward == pytest.approx(info["task_reward"] - 0.5 * info["dtw_penalty"])
            rows = textbook(np.array(path), recorded)
            assert info["dtw_distance"] == pytest.approx(rows[-1].min(), abs=1e-9)
            assert info["aligned_step"] == rows[-1].argmin()
            done = terminated or truncated
        assert sum(paid) == pytest.approx(rows[-1].min() - rows[0].min(), abs=1e-9)


@pytest.mark.parametrize("focal", ["predator_0", "prey"])
def test_closeness_is_paid_as_the_textbook_says_and_only_while_the_recording_lasts(
    focal: str,
) -> None:
    """The prey coasts, so that it outlives its recording: there its pay for lasting is refunded."""
    env = DTWReward(gym.make("AnimaRL/Agent-v0", focal=focal, others="coast"))
    world = env.unwrapped.world  # type: ignore[attr-defined]
    who = world.scenario.names.index(focal)
    rng = np.random.default_rng(1)
    outlived = 0
    for seed in range(6):
        _, info = env.reset(seed=seed)
        recorded = world.demos.episode(info["demo"]).positions[:, who]
        path, rewards, tasks = [world.position[0, who].copy()], [], []
        done = False
        while not done:
            action = int(rng.integers(13)) if seed % 2 else 12
            _, reward, terminated, truncated, info = env.step(action)
            path.append(world.position[0, who].copy())
            rewards.append(reward)
            tasks.append(info["task_reward"])
            done = terminated or truncated
        paid = closeness(np.array(path), recorded, WINDOW, scale=0.1)
        assert ((paid >= 0.0) & (paid <= 1.0)).all()
        beyond = slice(len(recorded) - 1, None)
        lasting = np.zeros(len(paid))
        if focal == "prey":
            lasting[beyond] = np.where(np.array(tasks[beyond]) > 0.0, world.scenario.species.dt, 0)
        np.testing.assert_allclose(rewards, np.array(tasks) + paid - lasting, atol=1e-9)
        outlived += len(paid[beyond])
    assert outlived > 50


def test_one_who_follows_late_is_close_and_one_who_stands_is_not() -> None:
    """What the band is for: with free warping, standing at the start would cost nothing."""
    t = np.arange(30.0)[:, None]
    recorded = np.hstack([t, np.zeros_like(t)])
    late = np.concatenate([recorded[:1].repeat(WINDOW, axis=0), recorded[:-WINDOW]])
    standing = recorded[:1].repeat(30, axis=0)
    np.testing.assert_allclose(closeness(late, recorded, WINDOW, scale=1.0), 1.0)
    assert closeness(standing, recorded, WINDOW, scale=1.0)[WINDOW:].max() < 0.5
    assert closeness(standing, recorded, 30, scale=1.0).min() == 1.0


def test_cumulative_penalty_is_the_row_minimum() -> None:
    env = DTWReward(gym.make("AnimaRL/Agent-v0"), penalty="cumulative")
    env.reset(seed=1)
    for _ in range(4):
        info = env.step(6)[4]
        assert info["dtw_penalty"] == info["dtw_distance"]


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_in_a_vector_each_copy_resets_its_own_rows(mode: str) -> None:
    copies = 6
    kind = gym.vector.AutoresetMode[mode]
    vector = DTWRewardVector(AnimalVectorEnv("agent", copies, autoreset_mode=kind))
    world = vector.unwrapped.world  # type: ignore[attr-defined]
    rng = np.random.default_rng(5)
    vector.reset(seed=10)
    paths: list[list[Any]] = [[world.position[b, 0].copy()] for b in range(copies)]
    recorded = [world.demos.episode(int(world.demo[b])).positions[:, 0] for b in range(copies)]
    ended = np.zeros(copies, dtype=bool)
    resets = 0
    for _ in range(250):
        *_, terminated, truncated, infos = vector.step(rng.integers(13, size=copies))
        for b in range(copies):
            over = bool(terminated[b] or truncated[b])
            started_now = (ended[b] and mode == "NEXT_STEP") or (over and mode == "SAME_STEP")
            if started_now and mode == "NEXT_STEP":
                assert infos["dtw_penalty"][b] == 0.0
            if started_now:
                resets += 1
                paths[b] = [world.position[b, 0].copy()]
                recorded[b] = world.demos.episode(int(world.demo[b])).positions[:, 0]
            else:
                paths[b].append(world.position[b, 0].copy())
            expected = textbook(np.array(paths[b]), recorded[b])[-1].min()
            assert infos["dtw_distance"][b] == pytest.approx(expected, abs=1e-9)
            ended[b] = over
    assert resets > 5


def test_parallel_view_keeps_a_row_for_each_individual() -> None:
    env = DTWRewardParallel(animarl_envs.parallel_env("agent"), alpha=2.0)
    world = env.unwrapped.world
    env.reset(seed=2)
    recorded = world.demos.episode(int(world.demo[0])).positions
    path = [world.position[0].copy()]
    rng = np.random.default_rng(0)
    while env.agents:
        agents = list(env.agents)
        _, rewards, _, _, infos = env.step({a: int(rng.integers(13)) for a in agents})
        path.append(world.position[0].copy())
        for i, agent in enumerate(agents):
            rows = textbook(np.array(path)[:, i], recorded[:, i])
            assert infos[agent]["dtw_distance"] == pytest.approx(rows[-1].min(), abs=1e-9)
            paid = infos[agent]["task_reward"] - 2.0 * infos[agent]["dtw_penalty"]
            assert rewards[agent] == pytest.approx(paid)
