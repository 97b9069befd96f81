"""Wrappers beside what they wrap, and the DTW reward of every view against a textbook DTW.

test_registry.py compares the views of every wrapped environment.
"""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refuses
from textbook_dtw import closeness, textbook

import animarl_envs
from animarl_envs.dtw import WINDOW
from animarl_envs.views import AnimalVectorEnv
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
    options = {"start": start, "condition": condition}
    plain = animarl_envs.parallel_env("agent", demos=None, **options)
    env = ConditionFlagParallel(plain, cue=cue)
    observations, _ = env.reset(seed=0)
    told = {"flipped": 1 - condition}.get(cue, cue)
    assert {row[-1] for row in observations.values()} == {told}
    _, rewards, terminated, _, infos = env.step({"predator_0": 0, "predator_1": 12, "prey": 12})
    assert terminated["prey"]
    assert (rewards["predator_0"], rewards["predator_1"]) == (1.0, paid)
    assert infos["prey"]["condition"] == condition


def followed(env: Any, who: int, seed: int, action: Any) -> tuple[Any, ...]:
    """Recording and path of one individual in an episode, its rewards, and infos by name."""
    world = env.unwrapped.world
    _, info = env.reset(seed=seed)
    recorded = world.demos.episode(info["demo"]).positions[:, who]
    path, rewards, infos, done = [world.position[0, who].copy()], [], [], False
    while not done:
        _, reward, terminated, truncated, info = env.step(action())
        path.append(world.position[0, who].copy())
        rewards.append(reward)
        infos.append([info[f"dtw_{key}"] for key in ("penalty", "distance")])
        infos[-1] += [info["aligned_step"], info["task_reward"]]
        done = terminated or truncated
    return recorded, np.array(path), np.array(rewards), *np.array(infos).T


def test_single_view_pays_every_row_as_the_textbook_says() -> None:
    plain, rng = gym.make("AnimaRL/Agent-v0", focal="predator_1"), np.random.default_rng(3)
    env = DTWReward(plain, alpha=0.5, penalty="increment")
    for seed in range(5):
        recorded, path, rewards, penalty, distance, aligned, task = followed(
            env, 1, seed, lambda: int(rng.integers(13))
        )
        np.testing.assert_allclose(rewards, task - 0.5 * penalty)
        rows = textbook(path, recorded)
        np.testing.assert_allclose(distance, rows[1:].min(axis=1), atol=1e-9)
        np.testing.assert_array_equal(aligned, rows[1:].argmin(axis=1))
        np.testing.assert_allclose(penalty, np.diff(rows.min(axis=1)), atol=1e-9)


@pytest.mark.parametrize("alpha", [1.0, 0.5, 5.0])
@pytest.mark.parametrize("focal", ["predator_0", "prey"])
def test_closeness_is_paid_as_the_textbook_says_and_only_while_the_recording_lasts(
    focal: str, alpha: float
) -> None:
    """The prey coasts, so that it outlives its recording: there its pay for lasting is refunded."""
    agent = gym.make("AnimaRL/Agent-v0", focal=focal, others="coast")
    env = DTWReward(agent, alpha)
    scenario = env.unwrapped.scenario  # type: ignore[attr-defined]
    rng, outlived = np.random.default_rng(1), 0
    for seed in range(6):
        recorded, path, rewards, *_, task = followed(
            env, scenario.names.index(focal), seed,
            (lambda: int(rng.integers(13))) if seed % 2 else lambda: 12,
        )  # fmt: skip
        paid = closeness(path, recorded, WINDOW, scale=0.1)
        assert ((paid >= 0.0) & (paid <= 1.0)).all()
        beyond = slice(len(recorded) - 1, None)
        lasting = np.zeros(len(paid))
        if focal == "prey":
            lasting[beyond] = np.where(task[beyond] > 0.0, scenario.species.dt, 0)
        np.testing.assert_allclose(rewards, task + alpha * paid - lasting, atol=1e-9)
        outlived += len(paid[beyond])
    assert outlived > 50


def test_in_a_vector_each_copy_resets_its_own_rows() -> None:
    """As it ends; where it ends a step later, test_registry.py has it beside single views."""
    copies = 6
    kind = gym.vector.AutoresetMode.SAME_STEP
    vector = DTWRewardVector(AnimalVectorEnv("agent", copies, autoreset_mode=kind))
    world = vector.unwrapped.world  # type: ignore[attr-defined]
    rng = np.random.default_rng(5)
    vector.reset(seed=10)
    paths: list[list[Any]] = [[world.position[b, 0].copy()] for b in range(copies)]
    recorded = [world.demos.episode(int(world.demo[b])).positions[:, 0] for b in range(copies)]
    resets = 0
    for _ in range(250):
        *_, terminated, truncated, infos = vector.step(rng.integers(13, size=copies))
        for b in range(copies):
            if terminated[b] or truncated[b]:
                resets += 1
                paths[b] = [world.position[b, 0].copy()]
                recorded[b] = world.demos.episode(int(world.demo[b])).positions[:, 0]
            else:
                paths[b].append(world.position[b, 0].copy())
            expected = textbook(np.array(paths[b]), recorded[b])[-1].min()
            assert infos["dtw_distance"][b] == pytest.approx(expected, abs=1e-9)
    assert resets > 5
