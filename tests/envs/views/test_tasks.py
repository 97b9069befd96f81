"""The tasks: opponents act, time costs, starts lie all around."""

import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray
from refusals import refuses

import animarl_envs
from animarl_envs.errors import MissingExtraError
from animarl_envs.species import SILKMOTH, SPECIES
from animarl_envs.species.options import with_options
from animarl_envs.tasks import TASKS
from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth
from animarl_envs.wrappers import DTWReward

CHASES = ("agent", "fly", "newt")
COPIES = 100


def make(name: str, kind: str = "Task", **options: Any) -> Any:
    made = gym.make_vec(f"AnimaRL/{name.capitalize()}{kind}-v0", num_envs=COPIES, **options)
    return made.unwrapped


def first_episodes(env: Any, act: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return and outcome of the first episode of each copy."""
    seen, _ = env.reset(seed=1)
    total, outcome = np.zeros(COPIES), np.zeros(COPIES, dtype=np.int64)
    running = np.ones(COPIES, dtype=bool)
    while running.any():
        seen, reward, terminated, truncated, info = env.step(act(seen))
        total += reward * running
        outcome[running] = info["outcome"][running]
        running &= ~(terminated | truncated)
    return total, outcome


def constant(action: int) -> Any:
    return lambda seen: np.full(COPIES, action)


@pytest.mark.parametrize("name", CHASES)
def test_tasks_are_not_solved_by_heading_for_the_target(name: str) -> None:
    """Straight at a target that replays its recording, or a few degrees beside it, catches it."""
    recorded, _ = first_episodes(make(name, kind=""), constant(0))
    assert recorded.mean() > 0.5
    for action in (0, 1, 11):
        _, outcome = first_episodes(make(name), constant(action))
        assert (outcome == 1).mean() < 0.45


@pytest.mark.parametrize("name", CHASES)
def test_tasks_have_opponents_that_act_and_a_cost_of_time(name: str) -> None:
    env = make(name)
    assert env.scenario.drivers == ("action", "scripted", "scripted")
    assert env.scenario.paired
    env.reset(seed=0)
    cost = env.scenario.species.step_cost
    assert cost == 0.5 / env.time_limit
    reward = env.step(np.zeros(COPIES, dtype=int))[1]
    assert set(reward) <= {-cost, 1.0 - cost}
    assert np.mean(reward == -cost) > 0.9
    world = make(name, kind="")
    assert world.scenario.drivers == ("action", "replay", "replay")
    assert world.scenario.species == SPECIES[name]


def test_tasks_keep_what_the_caller_says() -> None:
    task, given = TASKS["AgentTask"].species, {"boundary_penalty": -2.0, "time_cost": 0.0}
    env = animarl_envs.parallel_env("AgentTask", **given)
    assert env.scenario.species == with_options(task, **given)
    assert make("fly", contact_radius=0.3).scenario.species.contact_radius == 0.3
    several = animarl_envs.parallel_env("flytask", num_targets=2, start="uniform").scenario.species
    assert several.locomotion[-1] == SPECIES["fly"].locomotion[0]
    assert several.locomotion[0] == TASKS["FlyTask"].species.locomotion[-1]
    free = gym.make("AnimaRL/Shoal-v0").unwrapped
    assert free.scenario.drivers[1:] == ("replay",) * 11  # type: ignore[attr-defined]


def test_tasks_lose_nothing_to_options_beside_it() -> None:
    larger = animarl_envs.parallel_env("AgentTask", arena=1.5).scenario.species
    assert larger.arena.rebound and larger.arena.size == 1.5
    faster = animarl_envs.parallel_env("AgentTask", locomotion={"predator_0": 1.1}).scenario.species
    own = SPECIES["agent"].locomotion
    ratios = [a.thrust / b.thrust for a, b in zip(faster.locomotion, own, strict=True)]
    assert ratios == pytest.approx([1.1, 1.0, 1.3])


def test_tasks_of_a_moth_start_on_all_sides_of_the_source() -> None:
    env = make("silkmoth")
    env.reset(seed=0)
    x, y = env.world.position[:, 0].T
    assert np.hypot(x, y).min() >= 2 * SILKMOTH.contact_radius
    assert -0.1 <= x.min() < 0.0 and 0.35 < x.max() <= 0.4
    assert -0.25 <= y.min() < -0.2 and 0.2 < y.max() <= 0.25
    fixed = make("silkmoth", start_region=())
    fixed.reset(seed=0)
    assert (fixed.world.position[:, 0] == [SILKMOTH.start_distance, 0.0]).all()


def test_tasks_of_a_moth_are_not_solved_by_going_upwind() -> None:
    env = make("silkmoth", observation="full")
    for action in (0, 1, 11):
        assert (first_episodes(env, constant(action))[1] == 1).mean() < 0.25
    moths = ProgrammedMoth(COPIES, np.random.default_rng(0))
    assert (first_episodes(env, lambda seen: moths.act(seen[:, None])[:, 0])[1] == 1).mean() > 0.3


def test_tasks_for_memory_show_the_hits_of_this_step_alone() -> None:
    env = gym.make_vec("AnimaRL/SilkmothMemory-v0", num_envs=COPIES).unwrapped
    full = make("silkmoth", observation="full")
    rng = np.random.default_rng(0)
    seen, everything = env.reset(seed=3)[0], full.reset(seed=3)[0]
    hits = np.zeros(2)
    for _ in range(60):
        np.testing.assert_array_equal(seen, everything[:, 10:12])
        hits += seen.sum(axis=0)
        actions = rng.integers(13, size=COPIES)
        seen, everything = env.step(actions)[0], full.step(actions)[0]
    assert (hits > 0).all()
    assert env.single_observation_space.shape == (2,)


def test_tasks_without_recorded_starts_refuse_the_reward_of_recordings() -> None:
    refuses("start='demo'", DTWReward, gym.make("AnimaRL/SilkmothTask-v0"))


def test_gymnasiums_checker_passes_without_the_extra_for_pictures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    check_env(gym.make("AnimaRL/Agent-v0").unwrapped)
    with pytest.raises(MissingExtraError, match=r"animarl\[render\]"):
        gym.make("AnimaRL/Agent-v0", render_mode="rgb_array")
