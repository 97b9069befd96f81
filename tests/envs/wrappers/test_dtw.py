"""The DTW reward through every view, against a textbook DTW."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from textbook_dtw import closeness, textbook

from animarl_envs.dtw import WINDOW
from animarl_envs.views import AnimalVectorEnv
from animarl_envs.wrappers import DTWReward, DTWRewardVector


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
    env = DTWReward(gym.make("AnimaRL/Agent-v0", focal=focal, others="coast", recorded=True))
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
